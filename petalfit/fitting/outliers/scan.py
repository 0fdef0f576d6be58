"""A cloud to be fitted, with what is known of its points before there is a model."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from petalfit.fitting.outliers.loss import AbstractBackground, AbstractLoss


@dataclasses.dataclass(frozen=True)
class Scan:
    """The points of a cloud, and the assumptions of its loss about them.

    Attributes:
        points: The points that have a weight, shape (n, 3).
        weights: The number of observations that each point counts for, shape (n,).
        order: A random order of the points, shape (n,); starts are searched for with the first ones.
        noise: σ, or None to estimate it.
        background: The model of points that do not belong to the surface; None if all belong to it.
        likely: Whether each point seems to belong to a surface, shape (n,).
        every_point: Whether every step is to take all points, however many there are.
    """

    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    order: Int[np.ndarray, " n"]
    noise: float | None
    background: AbstractBackground | None
    likely: Bool[np.ndarray, " n"]
    every_point: bool = False

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "n 3"],
        weights: Float[np.ndarray, " n"],
        order: Int[np.ndarray, " n"],
        noise: float | None,
        loss: AbstractLoss,
        every_point: bool,
    ) -> Scan:
        """The scan of points under the assumptions of a loss."""
        background, likely = loss.background(points), loss.likely(points)
        return cls(points, weights, order, noise, background, likely, every_point)

    def some(self, count: int) -> Int[np.ndarray, " m"]:
        """Indices of at most `count` points that seem to belong to a surface, in random order."""
        return self.order[self.likely[self.order]][:count]
