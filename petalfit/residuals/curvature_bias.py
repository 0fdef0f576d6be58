"""The bias that noise and curvature together put into tangent distances, and its removal.

A point blurred by noise across a ridge is nearest to a place that it does not come from, and its
distance has no longer the mean zero: least squares then finds ribs a little too high. The expected
score at the fitted surface is that bias, and needs no formula: perturb clean points of the surface by
noise of the right variance, find their foot points, and evaluate the score. With both signs of the
same perturbation the part linear in the noise cancels, which leaves the bias almost without scatter.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Waves per unit of the domain of the perturbation's three components. √2 cos has mean 0, variance 1;
# being a function of (u, v) and not of the order of the points, it repeats whatever the order.
_WAVES = np.array([[173.0, 113.0], [211.0, -89.0], [149.0, 157.0]])


def perturbation(uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Displacements of unit variance in every coordinate, one for each place of a surface."""
    return np.sqrt(2.0) * np.cos(2 * np.pi * uv @ _WAVES.T)
