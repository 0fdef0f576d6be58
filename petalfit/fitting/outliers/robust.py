"""The robust loss: points may be outliers, which are spread evenly in a box around all points."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from petalfit.fitting.likelihood.mixture import Mixture, box_volume, mixture
from petalfit.fitting.likelihood.quadrature import Quadrature
from petalfit.fitting.likelihood.scales import spread_of
from petalfit.fitting.outliers.local_planes import on_sheets
from petalfit.fitting.outliers.loss import AbstractBackground, AbstractLoss
from petalfit.fitting.outliers.other_sheets import on_other_sheets
from petalfit.fitting.solver.observer import report
from petalfit.observations import PointCloud
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True)
class Clutter(AbstractBackground):
    """A background of points that belong to no surface and are spread evenly in a box.

    Attributes:
        volume: The volume of the box around all points, along their principal axes.
    """

    volume: float

    @classmethod
    def around(cls, points: Float[np.ndarray, "n 3"]) -> Clutter:
        """Clutter in the box around the points."""
        return cls(box_volume(points))

    def mixture(
        self,
        model: AbstractSurface,
        distance: np.ndarray,
        beyond: np.ndarray,
        weights: np.ndarray,
        noise: float | None,
    ) -> Mixture:
        distance = np.abs(distance)
        start = spread_of(distance) if noise is None else noise
        area = float(np.sum(Quadrature.of(model).area))
        return mixture(distance, beyond, weights, self.volume, area, start, noise is not None)


class Robust(AbstractLoss):
    """The robust loss: each point counts by its probability to belong to the surface, not to clutter."""

    name: ClassVar[str] = "robust"
    meaning: ClassVar[str] = "points may be outliers or clutter, which are found"

    def background(self, points: np.ndarray) -> Clutter:
        return Clutter.around(points)

    def likely(self, points: np.ndarray) -> np.ndarray:
        return on_sheets(points)

    def petal_alone(self, cloud: PointCloud) -> PointCloud:
        report("telling the petal from a table and a stalk")
        used = np.flatnonzero(cloud.mass > 0)
        other = on_other_sheets(cloud.points[used])
        if not other.any():
            return cloud
        kept = np.ones(len(cloud))
        kept[used[other]] = 0.0
        return cloud.weighted(kept).noting(
            f"{np.count_nonzero(other):,} of {len(cloud):,} points lie on a flat table or a round stalk "
            "beside the petal and are left out; if they are meant, crop the cloud to them"
        )

    def log_likelihood(
        self,
        distance: np.ndarray,
        weights: np.ndarray,
        volume: float,
        area: float,
        noise: float,
    ) -> float:
        inside = np.full(len(distance), -np.inf)
        return mixture(distance, inside, weights, volume, area, max(noise, 1e-300)).log_likelihood
