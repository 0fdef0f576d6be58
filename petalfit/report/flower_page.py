"""The report of a flower: one self-contained HTML page with two views and a table of the petals."""

from __future__ import annotations

import html
import importlib.resources
import math
import os
from collections.abc import Sequence

import numpy as np

from petalfit.observations.atomic import atomic_path
from petalfit.report.colour import css, of_petal
from petalfit.report.rounding import count, plain
from petalfit.results import FlowerRecord
from petalfit.version import VERSION

_POINTS = 4000  # points in each view
_SIDE = 420  # pixels


def write_flower_report(result: FlowerRecord, path: str | os.PathLike[str]) -> None:
    """Write the petals of a flower as one HTML page, which needs no network, script or other file.

    The file is written completely or not at all. The same result gives the same bytes.

    Args:
        result: The flower.
        path: The path of the file; an existing file is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(_page(result), encoding="utf-8", newline="\n")


def _page(result: FlowerRecord) -> str:
    style = importlib.resources.files("petalfit.report").joinpath("page.css").read_text("utf-8")
    state = (
        ("warn", count(len(result.warnings), "warning")) if result.warnings else ("good", "good")
    )
    items = "".join(f"<li>{html.escape(str(warning))}</li>" for warning in result.warnings)
    warnings = (
        '<section class="warnings" role="note"><strong>Before you use these numbers</strong>'
        f"<ul>{items}</ul></section>"
        if items
        else ""
    )
    facts = {
        "petals": str(result.count),
        "layout": html.escape(result.layout.described),
        "points on petals": f"{100 * np.mean(result.labels >= 0):.1f} %",
        "error of the axis": _degrees(result.layout.axis_stderr),
    }
    listing = "".join(f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in facts.items())
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="petalfit {VERSION}">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "style-src 'unsafe-inline'\">\n"
        f"<title>Flower · petalfit</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        '<p class="eyebrow">petalfit · flower report</p>\n'
        f"<h1>{count(result.count, 'petal')} in {html.escape(result.target.described)} "
        f'<span class="status {state[0]}">{state[1]}</span></h1>\n<dl class="facts">{listing}</dl>\n'
        f"{warnings}\n<h2>Points by petal</h2>\n"
        f'<div class="pair">{_view(result, 1)}{_view(result, 2)}</div>'
        f"\n<h2>Petals</h2>\n{_table(result)}\n{_whorls(result)}\n{_shared(result)}\n{_spread(result)}\n"
        f'<p class="soft">{html.escape(result.made_by)} {html.escape(result.command)}</p>\n'
        "</main>\n</body>\n</html>\n"
    )


def _view(result: FlowerRecord, hidden: int) -> str:
    """The points in the colours of their petals, from above (hidden axis 1) or from the side (2)."""
    own = result.axis.into(result.target.points)
    across, up = (0, 2) if hidden == 1 else (0, 1)
    some = np.arange(0, len(own), max(1, len(own) // _POINTS))
    low, extent = own.min(axis=0), float(np.ptp(own, axis=0).max())
    x = (own[some, across] - low[across]) / extent * _SIDE
    y = (own[some, up] - low[up]) / extent * _SIDE
    y = y if hidden == 1 else _SIDE - y
    paths = []
    for petal in range(-1, result.count):
        mine = result.labels[some] == petal
        dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x[mine], y[mine], strict=True))
        paths.append(f'<path d="{dots}" stroke="{_colour(petal)}"/>')
    caption = (
        "From above, along the flower's axis." if hidden == 1 else "From the side, axis upwards."
    )
    return (
        f'<figure><svg viewBox="-4 -4 {_SIDE + 8} {_SIDE + 8}" role="img" aria-label="{caption}" '
        f'stroke-width="3" stroke-linecap="round" fill="none">{"".join(paths)}</svg>'
        f"<figcaption>{caption} Each petal has its colour; grey points belong to none.</figcaption>"
        "</figure>"
    )


def _colour(petal: int) -> str:
    """The colour of a petal, grey for none."""
    return "#999" if petal < 0 else css(of_petal(petal))


def _table(result: FlowerRecord) -> str:
    rows = "".join(
        f'<tr><td><span style="color:{_colour(k)}">●</span> {name}</td>'
        f"<td>{np.count_nonzero(result.labels == k):,}</td>"
        + "".join(
            f"<td>{plain(trait.value, 4)}</td>"
            for trait in (petal.traits.get(key) for key in ("length", "width", "area"))
            if trait is not None
        )
        + f"<td>{plain(petal.rms, 3)}</td><td>{html.escape(str(petal.status))}</td></tr>"
        for k, (name, petal) in enumerate(zip(result.names, result.petals, strict=True))
    )
    measured = bool(result.petals and result.petals[0].traits)
    heads = ["petal", "points", *(["length", "width", "area"] if measured else []), "rms", "fit"]
    return _tabled(heads, rows)


def _whorls(result: FlowerRecord) -> str:
    if not result.layout.whorls:
        return ""
    rows = "".join(
        f"<tr><td>{whorl.count}</td><td>{_turn(whorl.phase.value, whorl.phase.stderr)}</td>"
        f"<td>{_turn(whorl.opening.value, whorl.opening.stderr)}</td><td>{whorl.height}</td></tr>"
        for whorl in result.layout.whorls
    )
    return _section("Whorls", ("petals", "phase", "opening", "height"), rows)


def _spread(result: FlowerRecord) -> str:
    if not result.spread:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{spread.mean}</td><td>{spread.deviation}</td>"
        f"<td>{spread.count}</td></tr>"
        for name, spread in result.spread.items()
    )
    heads = ("number", "mean", "standard deviation between petals", "petals that determine it")
    return _section("How alike the petals are", heads, rows)


def _shared(result: FlowerRecord) -> str:
    if not result.shared:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{common}</td></tr>"
        for name, common in result.shared.items()
    )
    return _section("What all petals share", ("number", "common value"), rows)


def _section(title: str, heads: Sequence[str], rows: str) -> str:
    """A table under a title."""
    return f"<h2>{title}</h2>{_tabled(heads, rows)}"


def _tabled(heads: Sequence[str], rows: str) -> str:
    head = "".join(f"<th>{text}</th>" for text in heads)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _turn(value: float, stderr: float) -> str:
    return f"{math.degrees(value):.1f}° ± {_degrees(stderr)}"


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.1f}°" if math.isfinite(angle) else "not determined"
