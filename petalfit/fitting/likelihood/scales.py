"""Robust estimates of scale, and robust weights: a few extreme values hardly change them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree


def spread_of(distance: Float[np.ndarray, "..."]) -> float:
    """A robust standard deviation: that of a Gaussian with the same median distance from zero."""
    return 1.4826 * float(np.median(np.abs(distance)))


def geman_mcclure(
    distance: Float[np.ndarray, "..."], scale: float | Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Weights of the kernel r²/(1 + r²) of Geman and McClure (1987), with r in units of the scale."""
    return 1 / (1 + (distance / scale) ** 2) ** 2


def spacing(tree: KDTree) -> float:
    """The typical spacing of points on a surface: the side of the square that one point covers."""
    # The disc that reaches to the sixth neighbour has the area of six and a half points.
    sixth = np.median(np.asarray(tree.query(tree.data, 7)[0])[:, 6])
    return float(sixth * np.sqrt(np.pi / 6.5))
