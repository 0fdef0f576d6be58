"""The agreement of one observation with the fitted surface: distances, weights, noise."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64

from petalfit.observations import AbstractObservation
from petalfit.results.misfit import MisfitMap
from petalfit.surfaces import Domain


@dataclasses.dataclass(frozen=True, eq=False)
class Agreement:
    """The agreement of one target with the fitted surface.

    Attributes:
        target: The observation that was fitted.
        distances: Signed distances of its data, shape (n,). For a cloud, the normal distance of every
            point (+ on the side of the normal), or its distance from the edge if it lies beyond, in
            the target's unit. For a silhouette, the distance of every place of its contour from the
            model's outline (+ outside of it), in pixels.
        weights: The weight that every datum had in the fit, shape (n,).
        noise: Standard deviation of the distances, given or estimated, in their unit.
        uv: Foot points of a cloud on a single surface, shape (n, 2); else None.
    """

    target: AbstractObservation
    distances: Float64[np.ndarray, " n"]
    weights: Float64[np.ndarray, " n"]
    noise: float
    uv: Float64[np.ndarray, "n 2"] | None = None

    @property
    def used(self) -> Bool[np.ndarray, " n"]:
        """Whether each datum counts: it had a weight, and kept at least half of it in the fit."""
        return self.target.used(self.weights)

    @property
    def outliers(self) -> int:
        """The number of data that had a weight and were taken for outliers."""
        return self.target.outliers(self.weights)

    @property
    def rms(self) -> float:
        """Root mean square distance, in the unit of the distances."""
        squares = np.average(self.distances**2, weights=self.weights)
        return float(np.sqrt(squares)) if np.isfinite(squares) else float("inf")

    def misfit(self, domain: Domain) -> MisfitMap | None:
        """The map of mean distances over the domain of the surface; None if there are no foot points."""
        if self.uv is None:
            return None
        weights = np.where(self.used, self.weights, 0.0)
        return MisfitMap.of(domain, self.uv, self.distances, weights)

    @property
    def unit(self) -> str:
        """The unit of the distances: "length", the target's, or "px"."""
        return self.target.unit
