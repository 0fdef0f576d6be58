"""One self-contained HTML page that says what was fitted, how well, and what is not known."""

from __future__ import annotations

import html
import importlib.resources
import math
import os
from collections.abc import Iterator

import numpy as np

from petalfit import __version__  # pyright: ignore[reportAttributeAccessIssue]  # not lazy
from petalfit.fitting import result as results
from petalfit.fitting.result import FitResult
from petalfit.observations.atomic import atomic_path
from petalfit.report.charts import histogram_chart, map_chart, view_chart
from petalfit.report.colour import IGNORED, POINT, css
from petalfit.report.rounding import count, listed, plain
from petalfit.report.scene import BASE, OBLIQUE, SIDE, Scene, distance_limit, draw_map, draw_view
from petalfit.report.tables import (
    correlation_table,
    parameter_table,
    provenance_list,
    starts_table,
)

# Pixels, of which a page's pixel has two.
_WIDE, _NARROW, _MAP = 960, 880, 680


def write_report(result: FitResult, path: str | os.PathLike[str]) -> None:
    """Write a fit as one HTML page: table, pictures, distances, starts, correlations, provenance.

    The page needs no network and no other file, suits light and dark screens, phones and paper, and
    is the same to the byte for the same result. It is written whole or not at all.

    Args:
        result: The fit.
        path: The file; an existing one is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    page = _page(result)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")


def _page(result: FitResult) -> str:
    kind = html.escape(type(result.model).__name__)
    style = importlib.resources.files("petalfit.report").joinpath("page.css").read_text("utf-8")
    body = [
        _head(result),
        _warnings(result),
        "<h2>Parameters</h2>",
        parameter_table(result),
        _table_notes(result),
        *_pictures(result),
        '<div class="pair">',
        _correlations(result),
        _provenance(result),
        "</div>",
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="petalfit {__version__}">\n'
        f"<title>{kind} fit · petalfit</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )


def _status(result: FitResult) -> tuple[str, str]:
    """The style and the words of the one mark that everybody reads."""
    if not result.converged:
        return "bad", "not converged"
    if result.warnings:
        return "warn", f"converged, with {count(len(result.warnings), 'warning')}"
    return "good", "converged"


def _head(result: FitResult) -> str:
    kind = html.escape(type(result.model).__name__)
    style, words = _status(result)
    ended = (
        f"The fit converged after {count(result.steps, 'round')}."
        if result.converged
        else "<strong>The fit did not converge; the numbers below are where it stopped.</strong>"
    )
    used = int(np.count_nonzero(result.weights))
    without = len(result.target) - used
    ignored = f" ({without:,} more without weight)" if without else ""
    size = " × ".join(plain(side) for side in result.target.extent)
    of_noise = result.rms / result.noise if result.noise > 0 else math.nan
    times = f", {of_noise:.2f} σ" if math.isfinite(of_noise) and of_noise < 1e4 else ""
    known = sum(result.identifiable.values())
    facts = {
        "points": f"{used:,}",
        "target size": f"{size}",
        "rms distance": f"{plain(result.rms)}",
        "noise σ": f"{plain(result.noise)}",
        "determined parameters": f"{known} <small>of {len(result.names)} free</small>",
    }
    return (
        f'<p class="eyebrow">petalfit · fit report</p>\n<h1>{kind} fitted to '
        f'{count(used, "point")} <span class="status {style}">{words}</span></h1>\n'
        f'<p class="lead">{ended} The points{ignored} lie {plain(result.rms)} (rms{times}) '
        f"from the surface, with noise σ = {plain(result.noise)}, on a target {size} in size.</p>\n"
        '<dl class="facts">'
        + "".join(f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in facts.items())
        + "</dl>"
    )


def _warnings(result: FitResult) -> str:
    if result.converged and not result.warnings:
        return ""
    style = "" if result.converged else " bad"
    items = list(_grouped(result))
    if not result.converged:
        # The message begins with the reason and repeats the warnings.
        reason = result.message.removesuffix("; ".join(result.warnings)).rstrip("; ")
        items.insert(0, html.escape(f"{result.status}: {reason}"))
    heading = "Before you use these numbers"
    listing = "".join(f"<li>{item}</li>" for item in items)
    return (
        f'<section class="warnings{style}" role="note"><strong>{heading}</strong>'
        f"<ul>{listing}</ul></section>"
    )


def _grouped(result: FitResult) -> Iterator[str]:
    """Warnings on the whole first; those that say the same of several parameters as one."""
    of_parameters: dict[str, list[str]] = {}
    for warning in result.warnings:
        name, _, rest = warning.partition(" ")
        if name in result.values and rest:
            of_parameters.setdefault(rest, []).append(name)
        else:
            yield html.escape(warning)
    for rest, names in of_parameters.items():
        codes = listed([f"<code>{html.escape(name)}</code>" for name in names])
        yield f"{'each of ' if len(names) > 1 else ''}{codes} {html.escape(rest)}"


def _table_notes(result: FitResult) -> str:
    notes = [
        "Errors are one standard deviation, all other free parameters being free; intervals take "
        "them as Gaussian.",
        "The line on the right is the parameter's typical range, with its value and interval.",
    ]
    if not all(result.identifiable.values()):
        notes.append(
            "<strong>Not determined</strong>: the target leaves the parameter an error above 0.3 "
            "standard deviations of its typical range. Do not use the value."
        )
    if result.pose.scale != 1.0:
        notes.append(
            "Lengths are in the model's unit; one of it is "
            f"{plain(result.pose.scale, 6)} of the target's."
        )
    return f'<p class="soft">{" ".join(notes)}</p>'


def _pictures(result: FitResult) -> Iterator[str]:
    scene = Scene.of(result)
    oblique = draw_view(scene, OBLIQUE, _NARROW, (0.5, 1.2))
    side, base = (draw_view(scene, view, _WIDE, (0.25, 0.7)) for view in (SIDE, BASE))
    total = len(result.target)
    yield "<h2>Target and fit</h2>"
    yield (
        '<div class="views">'
        f'<figure class="tall">{view_chart(oblique)}<figcaption>The fitted surface and '
        f"{_share(oblique.drawn, total)} as {_swatch(POINT)} dots{_ignored(scene)}, from an "
        "oblique direction. Points behind the surface are hidden by it. Axes are the petal's: "
        "x across, y along, z normal; bars are in the target's unit.</figcaption></figure>"
        f"<figure>{view_chart(side)}<figcaption>From the side.</figcaption></figure>"
        f"<figure>{view_chart(base)}<figcaption>From the base, along the petal.</figcaption>"
        "</figure></div>"
    )
    limit = distance_limit(result)
    picture = draw_map(scene, limit, _MAP)
    yield "<h2>Distances</h2>"
    yield (
        f'<div class="pair"><figure>{map_chart(picture, scene, limit, result.noise)}<figcaption>'
        f"The fitted outline and {_share(picture.drawn, total)} in the plane of the petal, "
        "coloured by signed distance, positive on the side of the normal"
        f"{_ignored(scene)}. Noise alone shows no pattern here.</figcaption></figure>"
        f"<div>{_histogram(result)}\n<h3>Starts</h3>{starts_table(result)}</div></div>"
    )


def _histogram(result: FitResult) -> str:
    usable = (result.weights > 0) & np.isfinite(result.distances)
    if not (result.noise > 0 and math.isfinite(result.noise) and usable.any()):
        return "<p>There is no histogram: the noise is not a positive number.</p>"
    inside = result.distances[usable] / result.noise
    drawing, beyond = histogram_chart(inside, result.weights[usable])
    outside = f" {count(beyond, 'distance')} beyond the ends." if beyond else ""
    return (
        f"<figure>{drawing}<figcaption>Distances in units of the noise σ = {plain(result.noise)} "
        f"(bars), and the Gaussian that noise alone would give (line).{outside}</figcaption>"
        "</figure>"
    )


def _share(drawn: int, total: int) -> str:
    if drawn == total:
        return f"all {count(total, 'point')}" if total != 1 else "the only point"
    return f"{drawn:,} of {count(total, 'point')}, chosen at random,"


def _swatch(rgb: np.ndarray) -> str:
    return f'<span class="swatch" style="background:{css(rgb)}"></span>'


def _ignored(scene: Scene) -> str:
    return "" if scene.used.all() else f" ({_swatch(IGNORED)} without weight)"


def _correlations(result: FitResult) -> str:
    heat = correlation_table(result)
    text = (
        "<p>Fewer than two parameters are determined: there is nothing to correlate.</p>"
        if heat is None
        else '<p class="soft">Of the errors of the determined parameters. Near ±1, the target '
        f"tells a combination of the two better than either.</p>{heat}"
    )
    return f"<section><h2>Correlations</h2>{text}</section>"


def _provenance(result: FitResult) -> str:
    pose, kind = result.pose, html.escape(type(result.model).__name__)
    rotation = "<br>".join(
        " ".join(f"{number:+.6f}" for number in row) for row in pose.rotation.tolist()
    )
    moved = pose.scale != 1.0 or pose.translation.any() or (pose.rotation != np.eye(3)).any()
    rows = {
        "model": kind,
        "status": html.escape(result.status),
        "message": html.escape(result.message),
        "points": f"{len(result.target):,}",
        "rms distance": f"{result.rms!r}",
        "noise σ": f"{result.noise!r}",
    }
    if not moved:
        rows["pose"] = "the target is in the model's frame"
    else:
        rows["scale"] = f"{pose.scale!r}"
        rows["rotation"] = f"<code>{rotation}</code>"
        rows["translation"] = ", ".join(map(repr, pose.translation.tolist()))
    rows["petalfit"] = __version__
    rows["file format"] = f"{results.FORMAT}, version {results.VERSION}"
    arguments = "\n".join(f"    {name}={value!r}," for name, value in result.values.items())
    call = html.escape(f"petalfit.{type(result.model).__name__}(\n{arguments}\n)")
    return (
        f'<section class="provenance"><h2>Provenance</h2>{provenance_list(rows)}'
        f"<details><summary>The fitted model as code</summary><pre>{call}</pre></details></section>"
    )
