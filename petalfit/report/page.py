"""The report: one self-contained HTML page on what was fitted, how well, and what is undetermined."""

from __future__ import annotations

import html
import importlib.resources
import os
from collections.abc import Iterator

from petalfit.observations.atomic import atomic_path
from petalfit.report.charts import profile_chart, view_chart
from petalfit.report.colour import POINT, css
from petalfit.report.provenance import provenance
from petalfit.report.rounding import count, listed, plain, share
from petalfit.report.scene import BASE, OBLIQUE, SIDE, Scene, draw_view
from petalfit.report.shown import in_scene, shown
from petalfit.report.swatch import ignored, swatch
from petalfit.report.tables import (
    correlation_table,
    families_table,
    parameter_table,
    pose_table,
    starts_table,
    traits_table,
)
from petalfit.report.viewer import fingerprint, script, viewer
from petalfit.results import FitRecord
from petalfit.version import VERSION

# Widths in pixels of the pictures; a pixel of the page has two of them.
_WIDE, _NARROW = 960, 880


def write_report(result: FitRecord, path: str | os.PathLike[str]) -> None:
    """Write a fit as one HTML page: table, 3-D view, distances, starts, correlations, provenance.

    The page needs no network and no other file, and suits light and dark screens, phones and paper. The
    same result gives the same bytes. Without scripts or WebGL, and on paper, the 3-D view is a picture.
    The file is written completely or not at all.

    Args:
        result: The fit.
        path: The path of the file; an existing file is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    page = _page(result)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")


def _page(result: FitRecord) -> str:
    kind = html.escape(type(result.model).__name__)
    style = importlib.resources.files("petalfit.report").joinpath("page.css").read_text("utf-8")
    body = [
        _head(result),
        _warnings(result),
        "<h2>Parameters</h2>",
        parameter_table(result),
        _table_notes(result),
        pose_table(result),
        traits_table(result),
        *_pictures(result),
        *_profiles(result),
        '<div class="pair">',
        _correlations(result),
        provenance(result),
        "</div>",
    ]
    content = "\n".join(filter(None, body))
    program = script() if 'class="viewer"' in content else ""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="petalfit {VERSION}">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(program)}">\n'
        f"<title>{kind} fit · petalfit</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        f"{content}\n</main>\n"
        + (f"<script>{program}</script>\n" if program else "")
        + "</body>\n</html>\n"
    )


def _policy(program: str) -> str:
    """The content security policy: a browser may show the page's own content and run only our script."""
    scripts = f"'{fingerprint(program)}'" if program else "'none'"
    return f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {scripts}"


def _status(result: FitRecord) -> tuple[str, str]:
    """The style and the words of the badge at the top, which states how the fit ended."""
    if not result.converged:
        return "bad", "not converged"
    if doubts := result.doubts:
        return "warn", f"converged, with {count(len(doubts), 'warning')}"
    return "good", "converged"


def _head(result: FitRecord) -> str:
    kind = html.escape(type(result.model).__name__)
    style, words = _status(result)
    ended = (
        f"The fit converged after {count(result.steps, 'round')}."
        if result.converged
        else "<strong>The fit did not converge; the numbers below are where it stopped.</strong>"
    )
    parts = result.agreements
    known = sum(result.identifiable.values())
    facts = {}
    for part, name in zip(parts, _short_names(result), strict=True):
        suffix = f", {name}" if len(parts) > 1 else ""
        facts |= {f"{key}{suffix}": value for key, value in shown(part).facts(part).items()}
    if result.names:
        facts["determined parameters"] = f"{known} <small>of {len(result.names)} free</small>"
    else:
        facts["effective parameters"] = f"{plain(result.freedom)} <small>none has a name</small>"
    what = html.escape(listed([shown(part).named(part) for part in parts]))
    lead = " ".join(shown(part).sentence(part) for part in parts)
    return (
        f'<p class="eyebrow">petalfit · fit report</p>\n<h1>{kind} fitted to '
        f'{what} <span class="status {style}">{words}</span></h1>\n'
        f'<p class="lead">{ended} {lead}</p>\n'
        '<dl class="facts">'
        + "".join(f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in facts.items())
        + "</dl>"
    )


def _short_names(result: FitRecord) -> list[str]:
    """The short names of all targets: "cloud", or "mask 1" and "mask 2" if there are several."""
    kinds = [part.target.kind for part in result.agreements]
    return [
        kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}"
        for i, kind in enumerate(kinds)
    ]


def _warnings(result: FitRecord) -> str:
    if result.converged and not result.warnings:
        return ""
    style = "" if result.converged else " bad"
    first, rest = result.doubts_in_two
    if not result.converged:
        first.insert(0, f"{result.status}: {result.outcome}")
    more = f"<details><summary>{len(rest)} more</summary>{_listing(rest)}</details>" if rest else ""
    heading = "Before you use these numbers"
    return (
        f'<section class="warnings{style}" role="note"><strong>{heading}</strong>'
        f"{_listing(first)}{more}</section>"
    )


def _listing(sentences: list[str]) -> str:
    return f"<ul>{''.join(f'<li>{html.escape(sentence)}</li>' for sentence in sentences)}</ul>"


def _table_notes(result: FitRecord) -> str:
    notes = [
        '<span class="of-strips">The line on the right is the parameter\'s typical range, with its '
        "value and interval.</span>"
    ]
    if result.names:
        notes.insert(
            0,
            "Errors are one standard deviation, all other free parameters being free; intervals take "
            "them as Gaussian.",
        )
    if result.discrepancy is not None:
        notes.append(
            f"They allow for a misfit, a smooth field that {result.discrepancy.described}; noise alone "
            "would leave the smaller errors below the values."
        )
    if not all(result.identifiable.values()):
        notes.append(
            "<strong>Not determined</strong>: the target leaves the parameter an error above 0.3 "
            "standard deviations of its typical range. Do not use the value."
        )
    if result.pose.scale != 1.0:
        notes.append(
            "Lengths are in the model's unit; one of it is "
            f"{plain(float(result.pose.scale), 6)} of the target's."
        )
    return f'<p class="soft">{" ".join(notes)}</p>'


def _pictures(result: FitRecord) -> Iterator[str]:
    clouds = in_scene(result)
    yield "<h2>Target and fit</h2>"
    parts = clouds or [None]
    scenes = [Scene.of(result, part) for part in parts]
    if all(scene.finite for scene in scenes):
        yield viewer(result, scenes, parts)
        for scene, part in zip(scenes, parts, strict=True):
            yield _views(scene, len(part.distances) if part else 0)
        yield "<h2>Distances</h2>"
        of_clouds = iter(scenes)
        for part in result.agreements:
            shows = shown(part)
            yield shows.distances(result, part, next(of_clouds) if shows.in_scene else None)
    else:
        yield "<p>There are no pictures: the fitted surface is not finite.</p>"
    if result.ranking:
        yield f"<h2>Families</h2>{families_table(result)}"
    if result.starts:
        yield f"<h2>Starts</h2>{starts_table(result)}"


def _views(scene: Scene, total: int) -> str:
    oblique = draw_view(scene, OBLIQUE, _NARROW, (0.5, 1.2))
    side, base = (draw_view(scene, view, _WIDE, (0.25, 0.7)) for view in (SIDE, BASE))
    dots = ""
    if total:
        dots = f" and {share(oblique.drawn, total)} as {swatch(css(POINT))} dots{ignored(scene)}"
    hidden = " Points behind the surface are hidden by it." if total else ""
    return (
        '<div class="views">'
        f'<figure class="tall">{view_chart(oblique)}<figcaption>The fitted surface{dots}, from an '
        f"oblique direction.{hidden} Axes are the model's: "
        "x across, y along, z normal; bars are in the target's unit.</figcaption></figure>"
        f"<figure>{view_chart(side)}<figcaption>From the side.</figcaption></figure>"
        f"<figure>{view_chart(base)}<figcaption>From the base.</figcaption>"
        "</figure></div>"
    )


def _profiles(result: FitRecord) -> Iterator[str]:
    if not result.profiles:
        return
    yield "<h2>Profile likelihoods</h2>"
    yield (
        '<p class="soft">How much worse the target is explained (Δχ²) with the parameter held, all '
        "others fitted anew; the dot is the fitted value, and below the line lies the 95 % interval.</p>"
    )
    drawings = (
        f"<figure>{profile_chart(profile, name, result.values[name])}</figure>"
        for name, profile in result.profiles.items()
    )
    yield f'<div class="pair">{"".join(drawings)}</div>'


def _correlations(result: FitRecord) -> str:
    if not result.names:
        return ""
    heat = correlation_table(result)
    text = (
        "<p>Fewer than two parameters are determined: there is nothing to correlate.</p>"
        if heat is None
        else '<p class="soft">Of the errors of the determined parameters. Near ±1, the target '
        f"tells a combination of the two better than either.</p>{heat}"
    )
    return f"<section><h2>Correlations</h2>{text}</section>"
