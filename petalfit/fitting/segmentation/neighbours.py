"""The neighbours of every point, among which the points of its own sheet are found."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

COUNT = 24


class Neighbours(NamedTuple):
    """The nearest neighbours of every point, the nearest first.

    Attributes:
        points: The points, shape (n, 3).
        others: Indices of the neighbours, shape (n, k).
        offset: The way from each point to its neighbours, shape (n, k, 3).
        distance: The lengths of these ways, shape (n, k).
    """

    points: Float[np.ndarray, "n 3"]
    others: Int[np.ndarray, "n k"]
    offset: Float[np.ndarray, "n k 3"]
    distance: Float[np.ndarray, "n k"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"], count: int = COUNT) -> Neighbours:
        """The neighbours of points; there must be more than `count` of them."""
        gaps, index = map(np.asarray, KDTree(points).query(points, count + 1))
        return cls(points, index[:, 1:], points[index[:, 1:]] - points[:, None], gaps[:, 1:])

    @property
    def radius(self) -> Float[np.ndarray, "n 1"]:
        """The distance of each point to its farthest neighbour."""
        return self.distance[:, -1:]
