"""The pedicel, Eqs. 1 and 2: an uneven, bent cylinder."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces import AbstractDeformedSurface, Cylinder, Domain, Scalar, length
from petalfit.surfaces.waves import sin

_PI = jnp.pi


class Pedicel(AbstractDeformedSurface):
    """A swollen, bent cylinder (Eq. 2 of the paper), its axis along y, open at both ends.

    S = (r cos u, h v, r sin u) + n a_1 sin(πv − 1) + (a_2 sin πv, 0, a_2 sin πv), with u ∈ [0, 2π], v ∈
    [0, 1] and n the outward unit normal of the cylinder. The phase of one radian is as printed, so the
    swelling is negative below v = 1/π. Fig. 2 has a_1 = a_2 = 3 and does not state r and h.
    """

    r: Scalar = length(4.0, "r", (0.05, 100.0), (3.0, 10.0), "radius of the cylinder")
    h: Scalar = length(30.0, "h", (0.5, 500.0), (10.0, 60.0), "height of the cylinder")
    a_1: Scalar = length(3.0, "a_1", (-50.0, 50.0), (0.0, 3.5), "extent of the unevenness")
    a_2: Scalar = length(3.0, "a_2", (-100.0, 100.0), (-8.0, 8.0), "extent of the bend")
    domain: ClassVar[Domain] = Cylinder.domain
    orientation: ClassVar[float] = Cylinder.orientation
    regular: ClassVar[bool] = True
    edges: ClassVar[tuple[bool, bool]] = Cylinder.edges

    @property
    def base(self) -> Cylinder:
        return Cylinder(self.r, self.h)

    def offset(self, u: Array, v: Array) -> Array:
        bend = self.a_2 * sin(_PI * v)
        return jnp.stack([bend, jnp.zeros_like(u), bend], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.asarray(self.a_1 * sin(_PI * v - 1))
