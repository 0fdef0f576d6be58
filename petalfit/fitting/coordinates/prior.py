"""What is known of the coordinates before any data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float


class Prior(NamedTuple):
    """A Gaussian prior, whose cost is Σ (root (t − centre))²/2.

    Attributes:
        centre: Coordinates of the free parameters.
        root: 1 for a standard deviation of the typical range, 0 for nothing known.
    """

    centre: Float[Array | np.ndarray, " p"]
    root: Float[Array | np.ndarray, " p"]

    @classmethod
    def none(cls, count: int) -> Prior:
        """The prior of somebody who knows nothing."""
        return cls(np.zeros(count), np.zeros(count))
