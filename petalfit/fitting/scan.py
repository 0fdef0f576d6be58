"""A cloud to be fitted: what is known of its points before any model is there."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from petalfit.fitting.robust import Clutter
from petalfit.fitting.strays import on_sheets


@dataclasses.dataclass(frozen=True)
class Scan:
    """Points, and what else may be among them.

    Attributes:
        points: All that have a weight.
        weights: How many observations each counts for.
        order: A random one; its first ones are the points for a start.
        noise: σ, or None to estimate it.
        clutter: What else is there, if not all points belong to the surface.
        likely: Which points seem to belong to one.
    """

    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    order: Int[np.ndarray, " n"]
    noise: float | None
    clutter: Clutter | None
    likely: Bool[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "n 3"],
        weights: Float[np.ndarray, " n"],
        order: Int[np.ndarray, " n"],
        noise: float | None,
        loss: str,
    ) -> Scan:
        """A cloud that is clean, or that may hold anything besides if the loss is "robust"."""
        if loss == "linear":
            return cls(points, weights, order, noise, None, np.ones(len(points), bool))
        return cls(points, weights, order, noise, Clutter.around(points), on_sheets(points))

    def first(self, count: int) -> Scan:
        """So many of the first points."""
        return Scan(
            self.points[:count],
            self.weights[:count],
            self.order[self.order < count],
            self.noise,
            self.clutter,
            self.likely[:count],
        )

    def some(self, count: int) -> Int[np.ndarray, " m"]:
        """Numbers of some points that seem to belong to a surface."""
        return self.order[self.likely[self.order]][:count]
