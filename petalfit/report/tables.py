"""The tables of the page: parameters, pose, starts, families and correlations."""

from __future__ import annotations

import html
import math

import numpy as np

from petalfit.components import Parameter
from petalfit.report.charts import range_chart
from petalfit.report.rounding import decimals_of, fixed, measured, plain
from petalfit.results import FitRecord, WarningKind, quantile

_UNITS = {"length": "length", "1": "–"}
_MOST_STARTS = 12
_POSE = {
    "scale": ("–", "one unit of the model, in the target's"),
    "shift": ("length", "where the model's origin lies in the target's frame"),
    "turn": ("rad", "about the model's {axis} axis; the rotation is under Provenance"),
}


def _symbol(parameter: Parameter) -> str:
    """The paper's symbol as HTML; the part after an underscore is a subscript."""
    head, _, tail = parameter.symbol.partition("_")
    subscript = f"<sub>{html.escape(tail)}</sub>" if tail else ""
    return f"<var>{html.escape(head)}{subscript}</var>"


def parameter_table(result: FitRecord, level: float = 0.95) -> str:
    """A table of all parameters of the model: value ± error, interval, unit and meaning."""
    intervals = result.interval(level)
    rows = [
        _parameter_row(name, parameter, result, intervals.get(name))
        for name, parameter in result.declared.items()
    ]
    return _parameter_head(level, "in its typical range") + "\n".join(rows) + "\n</tbody></table>"


def _parameter_head(level: float, strip: str, what: str = "parameter") -> str:
    return (
        f'<table class="parameters"><thead><tr><th scope="col">{what}</th>'
        '<th scope="col" class="value">value ± standard error</th>'
        f'<th scope="col" class="reach">{100 * level:g} % interval</th>'
        '<th scope="col" class="unit">unit</th>'
        f'<th scope="col" class="strip">{strip}</th></tr></thead>\n<tbody>\n'
    )


def _parameter_row(
    name: str, parameter: Parameter, result: FitRecord, interval: tuple[float, float] | None
) -> str:
    value, error = result.values[name], result.stderr.get(name, math.nan)
    known = result.identifiable.get(name, False)
    if interval is None:
        kind, shown, reach = "fixed", _data(value, f"{value + 0.0:.10g}".replace("-", "−")), "fixed"
    elif not known:
        kind, shown = "unknown", f"≈ {_data(value, plain(value))}"
        reach = "<strong>not determined</strong>"
    else:
        rounded, rounded_error = measured(value, error)
        decimals = decimals_of(error)
        kind = "known"
        shown = f'{_data(value, rounded)} <span class="error">± {rounded_error}</span>'
        if result.discrepancy is not None:
            by_noise = plain(result.stderr_noise[name], 2)
            shown += f'<span class="note soft">± {by_noise} by noise alone</span>'
        reach = " to ".join(fixed(end, decimals) for end in interval)
    notes = [
        f'<span class="note">{html.escape(warning.about)}</span>'
        for warning in result.warnings
        if warning.parameter == name and warning.kind is not WarningKind.NOT_DETERMINED
    ]
    unit = _UNITS.get(parameter.unit, parameter.unit)
    return (
        f'<tr class="{kind}"><th scope="row"><code>{html.escape(name)}</code> {_symbol(parameter)}'
        f'<span class="meaning">{html.escape(parameter.meaning)}</span></th>'
        f'<td class="value">{shown}{"".join(notes)}</td><td class="reach">{reach}</td>'
        f"{_unit(unit)}"
        f'<td class="strip">{range_chart(value, interval, parameter.typical)}</td></tr>'
    )


def pose_table(result: FitRecord, level: float = 0.95) -> str | None:
    """A table of a fitted pose and its errors; None if the pose was not fitted."""
    if not result.pose_stderr:
        return None
    values = {"scale": float(result.pose.scale)}
    values |= {
        f"shift_{a}": x for a, x in zip("xyz", result.pose.translation.tolist(), strict=True)
    }
    rows = []
    for name, error in result.pose_stderr.items():
        kind, _, axis = name.partition("_")
        unit, meaning = _POSE[kind]
        shown, reach = f"± {plain(error, 2)}", f"± {plain(quantile(level) * error, 2)}"
        if name in values:
            shown, reach = _with_error(values[name], error, level)
        rows.append(
            f'<tr class="known"><th scope="row"><code>{html.escape(name)}</code><span class="meaning">'
            f"{meaning.format(axis=axis)}"
            f'</span></th><td class="value">{shown}</td><td class="reach">{reach}</td>'
            f'{_unit(unit)}<td class="strip"></td></tr>'
        )
    return (
        f"<h3>Pose</h3>{_parameter_head(level, strip='')}" + "\n".join(rows) + "\n</tbody></table>"
    )


def traits_table(result: FitRecord, level: float = 0.95) -> str | None:
    """A table of the traits and their errors; None for a surface without traits."""
    if not result.traits:
        return None
    rows = []
    for name, trait in result.traits.items():
        kind, shown, reach = "fixed", _data(trait.value, plain(trait.value)), "error not known"
        if math.isfinite(trait.stderr) and trait.stderr > 0:
            kind, (shown, reach) = "known", _with_error(trait.value, trait.stderr, level)
        unit = _UNITS.get(trait.unit, trait.unit)
        term = f' <span class="meaning">{trait.term}</span>' if trait.term else ""
        rows.append(
            f'<tr class="{kind}"><th scope="row"><code>{html.escape(name)}</code>'
            f'<span class="meaning">{html.escape(trait.meaning)}</span>{term}</th>'
            f'<td class="value">{shown}</td><td class="reach">{reach}</td>{_unit(unit)}'
            '<td class="strip"></td></tr>'
        )
    head = _parameter_head(level, strip="", what="trait")
    return f"<h2>Traits</h2>{head}" + "\n".join(rows) + "\n</tbody></table>"


def _with_error(value: float, error: float, level: float) -> tuple[str, str]:
    """A value with its standard error, and its interval, as HTML."""
    rounded, rounded_error = measured(value, error)
    ends = (value + side * quantile(level) * error for side in (-1, 1))
    reach = " to ".join(fixed(end, decimals_of(error)) for end in ends)
    return f'{_data(value, rounded)} <span class="error">± {rounded_error}</span>', reach


def _unit(unit: str) -> str:
    return f'<td class="unit{" none" if unit == "–" else ""}">{html.escape(unit)}</td>'


def _data(value: float, text: str) -> str:
    """A rounded number as HTML that keeps all digits in the source, for copying."""
    return f'<data value="{value!r}" title="{value!r}">{html.escape(text)}</data>'


def starts_table(result: FitRecord) -> str:
    """A table of the end points of all starts, the best first."""
    shown = result.starts[:_MOST_STARTS]
    rows = [
        f'<tr><td>{html.escape(start.label)}</td><td class="number">{plain(start.rms, 4)}</td>'
        f'<td class="number">{plain(start.delta_chi2, 3)}</td></tr>'
        for start in shown
    ]
    left = len(result.starts) - len(shown)
    if left:
        rows.append(f'<tr><td colspan="3" class="more">and {left} more, all worse</td></tr>')
    return (
        '<table class="starts"><thead><tr><th scope="col">start</th><th scope="col" '
        'class="number">rms reached</th><th scope="col" class="number">Δχ² to the best</th>'
        "</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody></table>"
    )


def families_table(result: FitRecord) -> str:
    """A table of the fits of all families of petals, the best first."""
    rows = [
        f'<tr><td>{html.escape(rank.model)}</td><td class="number">{plain(rank.rms, 4)}</td>'
        f'<td class="number">{plain(rank.freedom, 3)}</td>'
        f'<td class="number">{plain(rank.delta_bic, 3)}</td></tr>'
        for rank in result.ranking
    ]
    return (
        '<table class="starts"><thead><tr><th scope="col">family</th><th scope="col" '
        'class="number">rms reached</th><th scope="col" class="number">numbers it may choose</th>'
        '<th scope="col" class="number">ΔBIC to the best</th>'
        "</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody></table>"
    )


def correlation_table(result: FitRecord) -> str | None:
    """The correlations of the determined parameters as a heat map; None for fewer than two of them."""
    declared = result.declared
    known = [i for i, name in enumerate(result.names) if result.identifiable[name]]
    covariance = result.covariance[np.ix_(known, known)]
    spread = np.sqrt(np.diag(covariance))
    if len(known) < 2 or not (np.isfinite(covariance).all() and (spread > 0).all()):
        return None
    correlation = covariance / np.outer(spread, spread)
    names = [result.names[i] for i in known]
    rows = []
    for row, name in enumerate(names[1:], 1):
        cells = "".join(
            _heat(float(correlation[row, column]), f"{name}, {names[column]}")
            for column in range(row)
        )
        rows.append(f'<tr><th scope="row"><code>{html.escape(name)}</code></th>{cells}</tr>')
    foot = "".join(f'<th scope="col">{_symbol(declared[name])}</th>' for name in names[:-1])
    return (
        '<div class="wide"><table class="heat"><tbody>\n'
        + "\n".join(rows)
        + f"\n</tbody><tfoot><tr><td></td>{foot}</tr></tfoot></table></div>"
    )


def _heat(correlation: float, pair: str) -> str:
    kind = "positive" if correlation > 0 else "negative"
    strength = min(abs(correlation), 1.0)
    return (
        f'<td class="{kind}" style="--strength:{100 * strength:.0f}%" '
        f'title="{html.escape(pair)}">{fixed(correlation, 2)}</td>'
    )
