"""The protocol of a kind of observation in a report."""

from __future__ import annotations

import abc
import math
from typing import ClassVar

import numpy as np

from petalfit.observations import Camera
from petalfit.report.charts import histogram_chart
from petalfit.report.rounding import count, plain
from petalfit.report.scene import Scene
from petalfit.results import Agreement, FitRecord


class AbstractShown(abc.ABC):
    """How observations of one kind are shown.

    Attributes:
        in_scene: Whether they have points, which are drawn in space with the surface.
    """

    in_scene: ClassVar[bool]

    @abc.abstractmethod
    def sentence(self, part: Agreement) -> str:
        """A sentence on how the observation and the fit agree."""

    @abc.abstractmethod
    def facts(self, part: Agreement) -> dict[str, str]:
        """The same as numbers, by their names."""

    @abc.abstractmethod
    def distances(self, result: FitRecord, part: Agreement, scene: Scene | None) -> str:
        """A drawing of the distances, as HTML.

        Args:
            result: The fit.
            part: The observation beside the surface.
            scene: The surface with the points of the observation, if it has any.
        """

    def named(self, part: Agreement) -> str:
        """The data that counted, in words."""
        return part.target.described

    def whole(self, part: Agreement) -> str:
        """The data that were given, in words."""
        return self.named(part)

    def camera(self, part: Agreement) -> Camera | None:
        """The camera that took it, if one did."""
        del part
        return None


def in_noise(part: Agreement) -> str:
    """The root mean square distance in units of the noise, behind a comma; empty if that says nothing."""
    of_noise = part.rms / part.noise if part.noise > 0 else math.nan
    return f", {of_noise:.2f} σ" if math.isfinite(of_noise) and of_noise < 1e4 else ""


def histogram(part: Agreement) -> str:
    """Distances in units of the noise, with the Gaussian that noise alone would give."""
    usable = part.used & np.isfinite(part.distances)
    if not (part.noise > 0 and math.isfinite(part.noise) and usable.any()):
        return "<p>There is no histogram: the noise is not a positive number.</p>"
    inside = part.distances[usable] / part.noise
    drawing, beyond = histogram_chart(inside, part.weights[usable])
    outside = f" {count(beyond, 'distance')} beyond the ends." if beyond else ""
    unit = " pixels" if part.unit == "px" else ""
    return (
        f"<figure>{drawing}<figcaption>Distances in units of the noise σ = {plain(part.noise)}{unit} "
        f"(bars), and the Gaussian that noise alone would give (line).{outside}</figcaption>"
        "</figure>"
    )
