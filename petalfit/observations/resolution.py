"""Whether coordinates are rounded too much for the shape that they have."""

import math

import numpy as np
from jaxtyping import Num

from petalfit.observations.errors import TargetError
from petalfit.observations.validation import bounds

# Steps of single precision, relative to the extent, from which there is a note and an error. Noise of
# a thousandth of the extent is that of a good scan; with steps of a twentieth no petal is left.
_COARSE, _TOO_COARSE = 1e-3, 0.05
_CHUNK = 1 << 17


def resolution_notes(points: Num[np.ndarray, "n 3"]) -> list[str]:
    """A note if the points have been rounded to single precision far away from the origin.

    Args:
        points: The points, finite, (N, 3).

    Returns:
        The note, or no notes.

    Raises:
        TargetError: The steps are so large that the shape is lost.
    """
    low, high = (end.astype(np.float64) for end in bounds(points))
    extent = math.hypot(*(high - low))
    largest = np.maximum(np.abs(low), np.abs(high))
    if extent == 0.0 or not largest.max() < np.finfo(np.float32).max:
        return []
    steps = np.spacing(largest.astype(np.float32)).astype(np.float64)
    step, axis = float(steps.max()), "xyz"[int(steps.argmax())]
    if step <= _COARSE * extent or not _is_single(points):
        return []
    said = (
        f"coordinates are rounded to steps of {step:.2g} in {axis} (single precision at "
        f"{largest.max():.6g}), and all points lie within {extent:.2g}"
    )
    if step >= _TOO_COARSE * extent:
        raise TargetError(
            f"{said}: their shape is lost. Export them in double precision, or with a common offset "
            "subtracted."
        )
    return [f"{said}: export them in double precision, or with a common offset subtracted"]


def _is_single(points: Num[np.ndarray, "n 3"]) -> bool:
    """Whether all coordinates are numbers of single precision."""
    return points.dtype == np.float32 or all(
        bool((part.astype(np.float32) == part).all())
        for part in (points[k : k + _CHUNK] for k in range(0, len(points), _CHUNK))
    )
