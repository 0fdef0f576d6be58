"""The target, the fit and the map of distances as one PNG, for a README or a slide."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from petalfit.observations.atomic import atomic_path
from petalfit.report.colour import NEGATIVE, POSITIVE, ZERO
from petalfit.report.overlay import Overlay
from petalfit.report.rounding import count, plain
from petalfit.report.scene import (
    BASE,
    OBLIQUE,
    SIDE,
    Picture,
    Scene,
    distance_limit,
    draw_map,
    draw_view,
)
from petalfit.report.shown import in_scene
from petalfit.results import FitRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "#7a7a80"  # legible on white and on black
_ROSE = "#c45a82"
_DPI = 160
_WIDTH, _HEIGHT = 10.1, 4.6  # inches


def write_picture(result: FitRecord, path: str | os.PathLike[str]) -> None:
    """Write the target and the fit from three sides and the map of distances as one PNG.

    The background is transparent and the text legible on light and dark. The file is written completely
    or not at all.

    Args:
        result: The fit.
        path: The path of the `.png` file; an existing file is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    figure = _figure(result)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        figure.savefig(
            file, format="png", dpi=_DPI, transparent=True, metadata={"Software": "petalfit"}
        )


def _figure(result: FitRecord) -> Figure:
    # Imported here, because importing matplotlib takes a second and a report does not need it.
    from matplotlib.figure import Figure

    clouds = in_scene(result)
    part = clouds[0] if clouds else result.agreements[0]
    scene = Scene.of(result, part if clouds else None)
    used = count(int(part.used.sum()), "point") if clouds else "mask"
    figure = Figure(figsize=(_WIDTH, _HEIGHT))
    tall = draw_view(scene, OBLIQUE, 900, (1.5, 1.5))
    _show(_axes(figure, 0.0, 0.1, 2.8, 4.2), tall, f"{type(result.model).__name__} and {used}")
    for view, bottom in ((SIDE, 2.35), (BASE, 0.1)):
        flat = draw_view(scene, view, 900, (0.61, 0.61))
        _show(_axes(figure, 2.95, bottom, 3.2, 1.95), flat, view.name)
    if clouds:
        limit = distance_limit(part)
        _map(figure, draw_map(scene, limit, 900, (1.5, 1.5)), scene, limit, part.noise)
    else:
        _overlay(figure, Overlay.of(result, part), part.noise)
    return figure


def _overlay(figure: Figure, overlay: Overlay, noise: float) -> None:
    """Draws the mask with the outline of the fit."""
    axes = _axes(figure, 6.5, 0.1, 3.5, 4.2)
    left, top, right, bottom = overlay.box
    grey = np.full((*overlay.mask.shape, 4), 0.55)
    grey[..., 3] = 0.6 * overlay.mask
    axes.imshow(grey, extent=(left, right, bottom, top))
    for ring in overlay.rings:
        axes.plot(*ring.T, color=_ROSE, linewidth=1.2)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    axes.set_axis_off()
    title = f"mask, and outline of the fit (noise {plain(noise)} px)"
    axes.set_title(title, color=_GREY, fontsize=10)


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """New axes at a place given in inches."""
    return figure.add_axes((left / _WIDTH, bottom / _HEIGHT, width / _WIDTH, height / _HEIGHT))


def _show(axes: Axes, picture: Picture, title: str) -> None:
    """Shows a picture with its scale of length, a title and no frame."""
    height, width = (side / picture.scale for side in picture.rgba.shape[:2])
    x, y = picture.corner
    axes.imshow(picture.rgba, extent=(x, x + width, y, y + height), interpolation="antialiased")
    axes.set_axis_off()
    axes.set_title(title, color=_GREY, fontsize=10)


def _map(figure: Figure, picture: Picture, scene: Scene, limit: float, noise: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    axes = _axes(figure, 6.7, 0.1, 2.8, 4.2)
    _show(axes, picture, f"signed distance (noise σ = {plain(noise)})")
    for outline in scene.outlines:
        axes.plot(*outline[:, :2].T, color=_ROSE, linewidth=1.0, zorder=0)
    colours = LinearSegmentedColormap.from_list("distance", [NEGATIVE, ZERO, POSITIVE])
    key = _axes(figure, 9.55, 1.2, 0.1, 2.0)
    figure.colorbar(ScalarMappable(Normalize(-limit, limit), colours), cax=key)
    key.tick_params(colors=_GREY, labelsize=8, length=3)
    key.locator_params(nbins=5)
    for spine in key.spines.values():
        spine.set_visible(False)
