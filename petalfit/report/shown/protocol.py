"""The interface by which a report shows a kind of observation."""

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
    """The presentation of observations of one kind in a report.

    Attributes:
        in_scene: Whether the observations have points that are drawn in space with the surface.
    """

    in_scene: ClassVar[bool]

    @abc.abstractmethod
    def sentence(self, part: Agreement) -> str:
        """A sentence on how well the observation and the fit agree."""

    @abc.abstractmethod
    def facts(self, part: Agreement) -> dict[str, str]:
        """The agreement as numbers, by name."""

    @abc.abstractmethod
    def distances(self, result: FitRecord, part: Agreement, scene: Scene | None) -> str:
        """A drawing of the distances, as HTML.

        Args:
            result: The fit.
            part: The agreement of the observation with the surface.
            scene: The surface with the points of the observation, if it has points.
        """

    def named(self, part: Agreement) -> str:
        """A phrase for the data that counted in the fit."""
        return part.target.described

    def whole(self, part: Agreement) -> str:
        """A phrase for all data that were given."""
        return self.named(part)

    def camera(self, part: Agreement) -> Camera | None:
        """The camera of the observation, or None."""
        del part
        return None


def in_noise(part: Agreement) -> str:
    """The rms distance in units of the noise, after a comma; empty if that is not informative."""
    of_noise = part.rms / part.noise if part.noise > 0 else math.nan
    return f", {of_noise:.2f} σ" if math.isfinite(of_noise) and of_noise < 1e4 else ""


def histogram(part: Agreement) -> str:
    """The histogram of distances in units of the noise, with the Gaussian that noise alone would give."""
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
