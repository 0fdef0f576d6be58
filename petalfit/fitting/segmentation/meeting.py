"""The place where the sheets of a flower meet, which is near the bases of its petals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

_CANDIDATES = 1500


def meeting_point(segments: Sequence[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "3"]:
    """The point of several segments that is the nearest to all of them: petals meet at their bases."""
    every = np.concatenate(segments)
    some = every[:: max(1, len(every) // _CANDIDATES)]
    away = sum(np.asarray(KDTree(segment).query(some)[0]) for segment in segments)
    return some[int(np.argmin(away))]
