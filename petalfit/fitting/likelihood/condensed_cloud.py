"""The likelihood of a large cloud by tangent distances, condensed to cells of a surface."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.cells import Cells, condense
from petalfit.fitting.likelihood.cloud import ObservedCloud, comparable
from petalfit.fitting.likelihood.foot_points import beside, signed_distance
from petalfit.fitting.likelihood.observed import Residuals
from petalfit.residuals import AbstractTerm, Data, TangentDistance
from petalfit.surfaces import AbstractSurface

# Across a petal lie its ribs and a sharp crest. Along it everything is smooth.
CELLS = Cells(128, 12, 0.25, inside=3.0)
# Points of a cloud that is not condensed: to condense fewer takes as long as to use them.
ENOUGH = 24576
_ROUNDING = 1e-9  # smaller noise, relative to the extent, is no noise


@dataclasses.dataclass(frozen=True)
class CondensedCloud(ObservedCloud):
    """The likelihood of many points beside a surface that they nearly lie on.

    Its `data` are the points that stand for those of each cell. If no noise is given, they have the noise
    of all points beside that surface.

    Attributes:
        points: All points, shape (n, 3).
        weights: The number of observations that each counts for, shape (n,).
        foot_points: Their foot points, shape (n, 2).
        places: The places of the points in `data`, shape (m, 2).
    """

    points: Float[np.ndarray, "n 3"] = dataclasses.field(kw_only=True)
    weights: Float[np.ndarray, " n"] = dataclasses.field(kw_only=True)
    foot_points: Float[np.ndarray, "n 2"] = dataclasses.field(kw_only=True)
    places: Float[np.ndarray, "m 2"] = dataclasses.field(kw_only=True)

    @classmethod
    def near(
        cls,
        surface: AbstractSurface,
        points: Float[np.ndarray, "n 3"],
        weights: Float[np.ndarray, " n"],
        noise: float | None,
        blur: float,
        free: int,
        sample: Data,
    ) -> CondensedCloud:
        """Condenses a cloud beside a surface.

        Args:
            surface: The surface.
            points: The points.
            weights: The number of observations that each point counts for.
            noise: σ, or None to estimate it.
            blur: About σ, in which the cells near the edges are measured.
            free: The number of free parameters.
            sample: A part of the cloud that is large enough to measure the bias on.
        """
        few = condense(points, weights, surface, blur, CELLS)
        if noise is None:
            variance = few.squares / max(float(np.sum(weights)) - free, 1.0)
            noise = max(np.sqrt(variance), _ROUNDING * float(np.max(np.abs(points))))
        data = Data.of(few.points, few.weights, noise)
        return cls(
            data,
            sample,
            points=points,
            weights=weights,
            foot_points=few.foot_points,
            places=few.uv,
        )

    @property
    def count(self) -> int:
        """The number of points that stand for all."""
        return len(self.data.points)

    def at(self, uv: Float[np.ndarray, "n 2"]) -> TangentDistance:
        return dataclasses.replace(super().at(uv), everywhere=True)

    @property
    def start(self) -> TangentDistance:
        """The term with the places where the cloud was condensed."""
        return self.at(self.places)

    def residuals(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> list[Residuals]:
        """The residuals of all points, at the foot points that they had when they were condensed."""
        found = beside(coordinates.model(t), self.points, self.foot_points)
        distance = signed_distance(*found)
        chi2 = comparable(distance, self.weights)
        noise = float(term.sigma)
        return [Residuals(distance, self.weights, noise, "length", chi2, self.foot_points)]
