"""What the notebooks draw with: lit surfaces, tables, and colours that are legible on light and dark."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython import get_ipython
from IPython.core.pylabtools import select_figure_formats
from IPython.display import Markdown
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

import petalfit as pf
from petalfit.report.portrait import Sheet, colours_on, portrait
from petalfit.surfaces.programs import position_and_normal

GREY, ROSE, BLUE, GREEN = "#7a7a80", "#c45a82", "#2e74b5", "#5f8f3f"
SIGNED = LinearSegmentedColormap.from_list("signed", [BLUE, "#d9d9dd", ROSE])
PINK, LEAF = pf.Colour.of("#f0b4c6"), pf.Colour.of("#84a94f")

# Figures that pyplot does not know are shown too; outside of Jupyter there is nothing to tell.
if shell := get_ipython():
    select_figure_formats(shell, {"png"}, bbox_inches="tight")
plt.rcParams.update(
    {
        "figure.dpi": 110,
        "figure.facecolor": "none",
        "axes.facecolor": "none",
        "savefig.facecolor": "none",
        "text.color": GREY,
        "axes.labelcolor": GREY,
        "axes.edgecolor": GREY,
        "axes.titlecolor": GREY,
        "axes.titlesize": 10,
        "axes.labelsize": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "xtick.color": GREY,
        "ytick.color": GREY,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "legend.frameon": False,
        "legend.fontsize": 8,
    }
)


def sheet(
    surface: pf.AbstractSurface,
    colour: pf.Colour = PINK,
    shift: Sequence[float] = (0.0, 0.0, 0.0),
    half: bool = False,
    resolution: tuple[int, int] = (97, 49),
) -> Sheet:
    """A surface as it is drawn; `half` shows only the part behind the axis of one that runs around."""
    (u_low, u_high), (v_low, v_high) = surface.domain
    u, v = np.linspace(u_low, u_high, resolution[0]), np.linspace(v_low, v_high, resolution[1])
    if half:
        v = np.linspace(-np.pi, 0.0, resolution[1])
    grid = (x.ravel() for x in np.meshgrid(u, v, indexing="ij"))
    with jax.enable_x64(True):
        vertices, normals = map(np.asarray, position_and_normal(surface, *grid))
    vertices, normals = (x.reshape(*resolution, 3) for x in (vertices, normals))
    return Sheet(vertices + shift, normals, colours_on(colour, resolution))


def panels(
    shown: Sequence[tuple[str, Sequence[Sheet]]],
    columns: int,
    size: int = 360,
    azimuth: float = 0.4,
    elevation: float = 0.35,
    width: float = 2.4,
) -> Figure:
    """Lit surfaces side by side, each with its title."""
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(width * columns, (width + 0.35) * rows))
    for number, (title, sheets) in enumerate(shown):
        axes = figure.add_subplot(rows, columns, number + 1)
        picture(axes, sheets, size, azimuth, elevation)
        axes.set_title(title, color=GREY, fontsize=9)
    figure.tight_layout(pad=0.8)
    return figure


def picture(
    axes: Axes,
    sheets: Sequence[Sheet],
    size: int = 360,
    azimuth: float = 0.4,
    elevation: float = 0.35,
) -> None:
    """Lit surfaces on axes of their own."""
    axes.imshow(portrait(sheets, (size, size), azimuth, elevation), interpolation="antialiased")
    axes.set_axis_off()


def looked_at(
    points: np.ndarray, azimuth: float = 0.4, elevation: float = 0.35
) -> tuple[np.ndarray, np.ndarray]:
    """Points as a portrait shows them: (n, 2) on the picture, y upwards, and how near each is."""
    a, e = azimuth, elevation
    right = [np.cos(a), 0.0, -np.sin(a)]
    up = [-np.sin(e) * np.sin(a), np.cos(e), -np.sin(e) * np.cos(a)]
    near = [np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)]
    return points @ np.array([right, up]).T, points @ np.array(near)


def dots(axes: Axes, points: np.ndarray, **style: object) -> object:
    """A cloud, seen as a portrait is, the nearest points on top."""
    seen, near = looked_at(points)
    order = np.argsort(near)
    colour = style.pop("c", BLUE)
    if not isinstance(colour, str):
        colour = np.asarray(colour)[order]
    drawn = axes.scatter(*seen[order].T, c=colour, linewidths=0, **{"s": 3, **style})
    axes.set_aspect("equal")
    axes.set_axis_off()
    return drawn


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> Markdown:
    """Rows of words and numbers, the numbers with four digits."""

    def cell(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, float) else str(value)

    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return Markdown("\n".join(f"| {' | '.join(map(cell, line))} |" for line in lines))
