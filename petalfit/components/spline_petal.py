"""A petal that follows a scan closely: Eq. 7 with spline fields for its three offsets."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.surfaces import AbstractSurface, Domain, Rectangle, Scalar, length

# Segments of the splines along u and along v; each field has three coefficients more than segments.
SEGMENTS = (7, 7)


class SplinePetal(AbstractSurface):
    """Eq. 7, (a_x u + Δx, b_y v + Δy, c_z + Δg), with offsets that are spline fields, not formulas.

    The fields are uniform cubic tensor-product B-splines. The rectangle's normal is +z, so Δg is the
    height.

    Attributes:
        offsets: The coefficients of (Δx, Δy, Δg), lengths, shape (m, n, 3); m and n are the numbers of
            segments along u and v plus 3.
    """

    a_x: Scalar = length(10.0, "a_x", (0.001, 1e5), (3.0, 40.0), "width of the rectangle")
    b_y: Scalar = length(10.0, "b_y", (0.001, 1e5), (3.0, 40.0), "length of the rectangle")
    c_z: Scalar = length(0.0, "c_z", (-1e5, 1e5), (-5.0, 5.0), "height of the rectangle", True)
    offsets: Float[Array | np.ndarray, "m n 3"] = eqx.field(
        default_factory=lambda: np.zeros((SEGMENTS[0] + 3, SEGMENTS[1] + 3, 3))
    )
    domain: ClassVar[Domain] = Rectangle.domain
    regular: ClassVar[bool] = True

    def position(self, u: Array, v: Array) -> Array:
        (i, across), (j, along) = basis(u + 0.5, SEGMENTS[0]), basis(v, SEGMENTS[1])
        steps = np.arange(4)
        nearby = jnp.asarray(self.offsets)[
            (i[..., None] + steps)[..., :, None], (j[..., None] + steps)[..., None, :]
        ]
        field = jnp.sum(across[..., :, None, None] * along[..., None, :, None] * nearby, (-3, -2))
        flat = jnp.stack([self.a_x * u, self.b_y * v, self.c_z * jnp.ones_like(u)], axis=-1)
        return flat + field


def basis(place: Array, segments: int) -> tuple[Array, Array]:
    """The index of the first of the four coefficients that act at places in [0, 1], and all weights."""
    first = jnp.clip(jnp.floor(place * segments), 0, segments - 1)
    t = place * segments - first
    weights = [
        (1 - t) ** 3,
        3 * t**3 - 6 * t**2 + 4,
        -3 * t**3 + 3 * t**2 + 3 * t + 1,
        t**3,
    ]
    return first.astype(int), jnp.stack(weights, axis=-1) / 6
