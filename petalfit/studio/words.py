"""The texts of the page, as HTML that suits its light and its dark theme."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

import numpy as np

from petalfit.fitting import FitResult, FlowerResult
from petalfit.report.colour import NEGATIVE, POSITIVE, ZERO, css
from petalfit.report.rounding import count, measured, plain

_SOFT = "opacity:0.72;font-size:0.86em"
_CELL = "padding:0.1em 0.35em;vertical-align:top"


def text(sentence: str) -> str:
    """A sentence of plain text as HTML."""
    return _block(html.escape(sentence))


def soft(sentence: str) -> str:
    """A sentence of plain text as HTML, in a softer colour."""
    return _block(f'<span style="{_SOFT}">{html.escape(sentence)}</span>')


def _block(content: str) -> str:
    style = "padding:0 0.75em 0.4em;line-height:1.35;font-size:0.9em;overflow-wrap:anywhere"
    return f'<div style="{style}">{content}</div>'


def verdict(result: FitResult) -> str:
    """The verdict on a fit: whether it converged, how close it came, and its warnings."""
    part = result.agreements[0]
    unit = " px" if part.unit == "px" else ""
    mark, words = ("✓", "converged") if result.converged else ("✗", "not converged")
    lines = [
        f"<strong>{mark} {type(result.model).__name__} {words}</strong> in "
        f"{sum(result.timings.values()):.2g} s, rms {plain(part.rms)}{unit}, "
        f"noise σ {plain(part.noise)}{unit}"
    ]
    if result.ranking:
        ranks = ", ".join(f"{html.escape(x.model)} {x.delta_bic:+.0f}" for x in result.ranking[1:])
        lines.append(f'<span style="{_SOFT}">ΔBIC of the others: {ranks}</span>')
    first, rest = result.doubts_in_two
    if not result.converged:
        first.insert(0, f"{result.status.meaning} {result.outcome}")
    lines += map(_doubt, first)
    more = "<br>".join(map(_doubt, rest))
    if rest:
        more = f'<details style="{_SOFT}"><summary>{len(rest)} more</summary>{more}</details>'
    return _block("<br>".join(lines) + more)


def flower(result: FlowerResult) -> str:
    """What was found in a scan of a flower: the number of petals, their layout, and warnings."""
    mark = "✓" if result.converged else "✗"
    on = 100 * float(np.mean(result.labels >= 0))
    lines = [
        f"<strong>{mark} {count(result.count, 'petal')}, {html.escape(result.layout.described)}</strong>",
        f'<span style="{_SOFT}">{on:.1f} % of the points on petals</span>',
    ]
    lines += [_doubt(str(warning)) for warning in result.warnings]
    return _block("<br>".join(lines))


def _doubt(sentence: str) -> str:
    return f'<span style="{_SOFT}">⚠ {html.escape(sentence)}</span>'


def table(result: FitResult) -> str:
    """A table of all parameters with their errors, which marks those that are not determined."""
    rows = []
    for name, parameter in result.declared.items():
        value, error = result.values[name], result.stderr.get(name, math.nan)
        if name not in result.stderr:
            shown, style = plain(value), _SOFT
            note = "fixed" if result.names else ""
        elif not result.identifiable[name]:
            shown, style, note = f"≈ {plain(value)}", _SOFT, "not determined"
        else:
            rounded, rounded_error = measured(value, error)
            shown, style, note = f"{rounded} ± {rounded_error}", "", ""
            if result.discrepancy is not None:
                note = f"± {plain(result.stderr_noise[name], 2)} by noise alone"
        unit = "" if parameter.unit in ("1", "length") else f" {html.escape(parameter.unit)}"
        rows.append(
            f'<tr style="{style}" title="{html.escape(parameter.meaning)}">'
            f'<td style="{_CELL}"><code>{html.escape(name)}</code></td>'
            f'<td style="{_CELL};text-align:right;white-space:nowrap">{shown}{unit}</td>'
            f'<td style="{_CELL};{_SOFT}">{note}</td></tr>'
        )
    return _block(
        '<table style="border-collapse:collapse;font-size:0.86em;width:100%">'
        + "".join(rows)
        + "</table>"
    )


def progress(stage: str, costs: Sequence[float]) -> str:
    """The stage of a running fit, and how close it was after each round."""
    return _block(f"{html.escape(stage)}{_curve(costs)}")


def _curve(costs: Sequence[float]) -> str:
    found = np.asarray(costs, float)
    found = np.log10(np.maximum(found[np.isfinite(found)], 1e-12))
    if len(found) < 2:
        return ""
    low, high = float(found.min()), float(found.max())
    x = np.linspace(2, 278, len(found))
    y = 40 - 36 * (found - low) / max(high - low, 1e-9)
    places = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return (
        f'<svg viewBox="0 0 280 44" style="width:100%;display:block" role="img">'
        f"<title>distance after each round, logarithmic</title>"
        f'<polyline points="{places}" fill="none" stroke="currentColor" stroke-width="1.5"/></svg>'
        f'<span style="{_SOFT}">{len(costs)} iterations seen; rms distance {plain(costs[-1])}</span>'
    )


def key(limit: float, unit: str) -> str:
    """The key to the colours of points."""
    stops = ", ".join(css(colour) for colour in (NEGATIVE, ZERO, POSITIVE))
    return _block(
        f'<div style="height:0.6em;border-radius:0.3em;background:linear-gradient(90deg, {stops})">'
        f'</div><div style="display:flex;justify-content:space-between;{_SOFT}">'
        f"<span>−{plain(limit, 2)}{unit}</span><span>distance</span>"
        f"<span>+{plain(limit, 2)}{unit}</span></div>"
    )


def edited(result: FitResult, rms: float | None, unit: str) -> str:
    """A comparison of the petal that the sliders show with the fitted one."""
    if rms is None:
        return soft("as the sliders say")
    fitted = result.agreements[0].rms
    return soft(
        f"as the sliders say: rms {plain(rms)}{unit}, {rms / max(fitted, 1e-300):.3g} times the fit's"
    )
