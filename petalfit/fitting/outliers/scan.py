"""A cloud that is to be fitted, with all that is known of its points before any model is there."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from petalfit.fitting.outliers.loss import AbstractBackground, AbstractLoss


@dataclasses.dataclass(frozen=True)
class Scan:
    """Points of a surface, and what else may be among them.

    Attributes:
        points: All points that have a weight.
        weights: How many observations each counts for.
        order: A random order of the points; a start is sought with the first ones.
        noise: σ, or None to estimate it.
        background: What else is there, if not all points belong to the surface.
        likely: Which points seem to belong to a surface.
    """

    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    order: Int[np.ndarray, " n"]
    noise: float | None
    background: AbstractBackground | None
    likely: Bool[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "n 3"],
        weights: Float[np.ndarray, " n"],
        order: Int[np.ndarray, " n"],
        noise: float | None,
        loss: AbstractLoss,
    ) -> Scan:
        """A cloud in which there may be whatever the loss makes allowance for."""
        background, likely = loss.background(points), loss.likely(points)
        return cls(points, weights, order, noise, background, likely)

    def first(self, count: int) -> Scan:
        """The scan of so many of the first points."""
        return Scan(
            self.points[:count],
            self.weights[:count],
            self.order[self.order < count],
            self.noise,
            self.background,
            self.likely[:count],
        )

    def some(self, count: int) -> Int[np.ndarray, " m"]:
        """Numbers of some points that seem to belong to a surface."""
        return self.order[self.likely[self.order]][:count]
