"""The bias that noise and curvature together put into tangent distances, and its removal.

A point blurred by noise across a ridge is nearest to a place that it does not come from, and its
distance has no longer the mean zero: least squares then finds ribs a little too high. The expected
score at the fitted surface is that bias, and needs no formula: perturb clean points of the surface by
noise of the right variance, find their foot points, and evaluate the score. With both signs of the
same perturbation the part linear in the noise cancels, which leaves the bias almost without scatter.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.residuals.contact import frame, pull_back
from petalfit.surfaces import AbstractSurface

# Waves per unit of the domain of the perturbation's three components. √2 cos has mean 0, variance 1;
# being a function of (u, v) and not of the order of the points, it repeats whatever the order.
_WAVES = np.array([[173.0, 113.0], [211.0, -89.0], [149.0, 157.0]])


def perturbations(
    surface: AbstractSurface, uv: Float[Array, "n 2"], sigma: Float[Array, ""]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Points of the surface at `uv`, moved by a perturbation of variance σ² in every coordinate.

    Returns:
        The points moved forth and the points moved back by the same perturbation.
    """
    clean = surface.position(uv[:, 0], uv[:, 1])
    noise = sigma * np.sqrt(2.0) * jnp.cos(2 * np.pi * uv @ _WAVES.T)
    return clean + noise, clean - noise


def distance_score(
    surface: AbstractSurface,
    points: Float[Array, "n 3"],
    uv: Float[Array, "n 2"],
    weights: Float[Array, " n"],
) -> AbstractSurface:
    """Σ w d ∂d/∂θ of the normal distances d at foot points `uv`.

    Its mean over both `perturbations`, divided by σ², is the expected score.

    Returns:
        A pytree like `surface`.
    """
    here = frame(surface, uv)
    distance = jnp.sum(here.normal * (points - here.position), axis=-1)
    # d = n·(x − S), so ∂d/∂θ = −n·∂S/∂θ
    pulled = pull_back(surface, uv, here.normal * (-weights * distance)[:, None])
    return jax.tree.map(lambda leaf: jnp.sum(leaf, axis=0), pulled)
