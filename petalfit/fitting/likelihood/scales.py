"""Robust estimates of scale, and robust weights: a few extreme values hardly change them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def spread_of(distance: Float[np.ndarray, "..."]) -> float:
    """A robust standard deviation: that of a Gaussian with the same median distance from zero."""
    return 1.4826 * float(np.median(np.abs(distance)))


def geman_mcclure(
    distance: Float[np.ndarray, "..."], scale: float | Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Weights of the kernel r²/(1 + r²) of Geman and McClure (1987), with r in units of the scale."""
    return 1 / (1 + (distance / scale) ** 2) ** 2
