"""The bias of tangent distances that noise and curvature cause together, and its removal.

A point that noise has moved across a ridge is nearest to a place from which it does not come, and the
mean of its distance is no longer zero: least squares then finds ribs slightly too high. The bias is the
expected score at the fitted surface, and can be computed without a formula: perturb clean points of the
surface by noise of the right variance, find their foot points, and evaluate the score. Using both signs
of the same perturbation cancels the part linear in the noise, so the bias has almost no scatter.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Waves per unit of the domain, for the three components of the perturbation. √2 cos has mean 0 and
# variance 1; as a function of (u, v) it does not depend on the order of the points.
_WAVES = np.array([[173.0, 113.0], [211.0, -89.0], [149.0, 157.0]])


def perturbation(uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """A displacement for each place of a surface, of unit variance in every coordinate."""
    return np.sqrt(2.0) * np.cos(2 * np.pi * uv @ _WAVES.T)
