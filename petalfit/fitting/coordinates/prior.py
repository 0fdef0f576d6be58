"""The prior on the coordinates: what is known before any data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float


class Prior(NamedTuple):
    """A Gaussian prior, whose cost is Σ (root (t − centre))²/2.

    Attributes:
        centre: Coordinates of the free parameters at the maximum of the prior, shape (p,).
        root: Inverse standard deviation of each coordinate, shape (p,): 1 for the spread of its typical
            range, 0 for no knowledge.
    """

    centre: Float[Array | np.ndarray, " p"]
    root: Float[Array | np.ndarray, " p"]

    @classmethod
    def none(cls, count: int) -> Prior:
        """The prior that knows nothing of `count` coordinates."""
        return cls(np.zeros(count), np.zeros(count))
