"""The table that a flower lies or stands on: a flat sheet that is larger than any petal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

_FLAT = 1.5  # root mean square distance from its plane, in noise, at the most
_LARGE = 1.5  # size of the sheet, by that of the second largest


def table_among(
    points: Float[np.ndarray, "n 3"], segments: Sequence[Int[np.ndarray, " _"]], noise: float
) -> int | None:
    """The number of the segment that is a table, or None if there is none.

    Args:
        points: The points.
        segments: The indices of the points of each segment.
        noise: Standard deviation of the points' distances from their sheets.
    """
    if len(segments) < 2:
        return None
    sizes = np.array([len(segment) for segment in segments])
    largest = int(np.argmax(sizes))
    if sizes[largest] < _LARGE * np.partition(sizes, -2)[-2]:
        return None
    return largest if _roughness(points[segments[largest]]) < _FLAT * noise else None


def _roughness(points: Float[np.ndarray, "m 3"]) -> float:
    """The root mean square distance of points from their plane."""
    away = points - points.mean(axis=0)
    least = np.linalg.eigvalsh(away.T @ away / len(points))[0]
    return float(np.sqrt(max(least, 0.0)))
