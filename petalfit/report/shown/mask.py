"""Silhouettes in a report, shown by the mask with its contour and the outline of the fit."""

from __future__ import annotations

from typing import ClassVar, cast

from petalfit.observations import Camera, Silhouette
from petalfit.report.charts import overlay_chart
from petalfit.report.overlay import Overlay
from petalfit.report.rounding import plain
from petalfit.report.scene import Scene, distance_limit
from petalfit.report.shown.protocol import AbstractShown, histogram, in_noise
from petalfit.results import Agreement, FitRecord


class ShownMask(AbstractShown):
    """A silhouette in a report: its image, with distances in pixels."""

    in_scene: ClassVar[bool] = False

    def sentence(self, part: Agreement) -> str:
        return (
            f"The mask's contour lies {plain(part.rms)} pixels (rms{in_noise(part)}) from the fitted "
            f"outline, with noise σ = {plain(part.noise)} pixels."
        )

    def facts(self, part: Agreement) -> dict[str, str]:
        mask = cast(Silhouette, part.target)
        rows, columns = mask.mask.shape
        return {
            "pixels": f"{columns} × {rows}",
            "covered": f"{round(mask.area):,}",
            "rms distance": f"{plain(part.rms)} px",
            "noise σ": f"{plain(part.noise)} px",
        }

    def distances(self, result: FitRecord, part: Agreement, scene: Scene | None) -> str:
        limit = distance_limit(part)
        drawing = overlay_chart(Overlay.of(result, part), limit, part.noise)
        return (
            f'<div class="pair"><figure>{drawing}<figcaption>The mask, its contour coloured by signed '
            "distance in pixels, positive where it lies outside of the fitted outline, and that outline "
            "as a line.</figcaption></figure>"
            f"<div>{histogram(part)}</div></div>"
        )

    def camera(self, part: Agreement) -> Camera | None:
        return cast(Silhouette, part.target).camera
