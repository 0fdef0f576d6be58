"""The paper's basic geometric shapes: rectangle (Eq. 7), cylinder (Eq. 1), ellipsoid (Eq. 3)."""

from __future__ import annotations

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces.surface import AbstractSurface, Domain, Scalar


class Rectangle(AbstractSurface):
    """The flat petal before deformation, Eq. 7 with Δx = Δy = Δg = 0: (a_x u, b_y v, c_z).

    Attributes:
        a_x: Width along x, in the unit of length, positive.
        b_y: Length along y, positive.
        c_z: Height of the plane (the paper's "section distance").
    """

    a_x: Scalar
    b_y: Scalar
    c_z: Scalar = 0.0
    domain: ClassVar[Domain] = Domain(u=(-0.5, 0.5), v=(0.0, 1.0))
    regular: ClassVar[bool] = True

    def position(self, u: Array, v: Array) -> Array:
        return jnp.stack([self.a_x * u, self.b_y * v, self.c_z * jnp.ones_like(u)], axis=-1)


class Cylinder(AbstractSurface):
    """Eq. 1: (r cos u, h v, r sin u), open at both ends, its axis along y.

    Attributes:
        r: Radius, in the unit of length, positive.
        h: Height, positive.
    """

    r: Scalar
    h: Scalar
    domain: ClassVar[Domain] = Domain(u=(0.0, 2 * math.pi), v=(0.0, 1.0))
    regular: ClassVar[bool] = True
    orientation: ClassVar[float] = -1.0  # Eq. 1 runs so that ∂u × ∂v points to the axis

    def position(self, u: Array, v: Array) -> Array:
        return jnp.stack([self.r * jnp.cos(u), self.h * v, self.r * jnp.sin(u)], axis=-1)


class Ellipsoid(AbstractSurface):
    """Eq. 3 with free half axes: (r_x cos u cos v, r_y sin u, r_z cos u sin v), poles on the y axis.

    Attributes:
        r_x: Half axis along x, in the unit of length, positive.
        r_y: Half axis along y, positive; the paper has 3 r_x.
        r_z: Half axis along z, positive.
    """

    r_x: Scalar
    r_y: Scalar
    r_z: Scalar
    domain: ClassVar[Domain] = Domain(u=(-math.pi / 2, math.pi / 2), v=(0.0, 2 * math.pi))

    def position(self, u: Array, v: Array) -> Array:
        return jnp.stack(
            [
                self.r_x * jnp.cos(u) * jnp.cos(v),
                self.r_y * jnp.sin(u),
                self.r_z * jnp.cos(u) * jnp.sin(v),
            ],
            axis=-1,
        )
