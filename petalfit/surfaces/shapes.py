"""The paper's basic geometric shapes: rectangle (Eq. 7), cylinder (Eq. 1), ellipsoid (Eq. 3)."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces.map import Domain, Scalar
from petalfit.surfaces.parameter import length
from petalfit.surfaces.surface import AbstractSurface
from petalfit.surfaces.waves import cos, sin


def _size(default: float, symbol: str, meaning: str) -> Any:
    """A parameter field for a length of a basic shape, with a wide range."""
    return length(default, symbol, (0.01, 500.0), (1.0, 40.0), meaning)


class Rectangle(AbstractSurface):
    """A flat rectangle (a_x u, b_y v, c_z): the petal of Eq. 7 with Δx = Δy = Δg = 0.

    c_z is the paper's "section distance".
    """

    a_x: Scalar = _size(10.0, "a_x", "width along x")
    b_y: Scalar = _size(20.0, "b_y", "length along y")
    c_z: Scalar = length(0.0, "c_z", (-200.0, 200.0), (-5.0, 5.0), "height of the plane")
    domain: ClassVar[Domain] = Domain(u=(-0.5, 0.5), v=(0.0, 1.0))
    regular: ClassVar[bool] = True

    def position(self, u: Array, v: Array) -> Array:
        return jnp.stack([self.a_x * u, self.b_y * v, self.c_z * jnp.ones_like(u)], axis=-1)


class Cylinder(AbstractSurface):
    """A cylinder (r cos u, h v, r sin u), Eq. 1, open at both ends, its axis along y."""

    r: Scalar = _size(5.0, "r", "radius")
    h: Scalar = _size(20.0, "h", "height")
    domain: ClassVar[Domain] = Domain(u=(0.0, 2 * math.pi), v=(0.0, 1.0))
    regular: ClassVar[bool] = True
    edges: ClassVar[tuple[bool, bool]] = (False, True)  # u is periodic
    orientation: ClassVar[float] = -1.0  # in Eq. 1 ∂S/∂u × ∂S/∂v points towards the axis

    def position(self, u: Array, v: Array) -> Array:
        return jnp.stack([self.r * cos(u), self.h * v, self.r * sin(u)], axis=-1)


class Ellipsoid(AbstractSurface):
    """An ellipsoid (r_x cos u cos v, r_y sin u, r_z cos u sin v), Eq. 3, its poles on the y axis.

    The paper ties the half axes to one radius; here they are free.
    """

    r_x: Scalar = _size(5.0, "r_x", "half axis along x")
    r_y: Scalar = _size(15.0, "r_y", "half axis along y; the paper has 3 r_x")
    r_z: Scalar = _size(5.0, "r_z", "half axis along z; the paper has r_x")
    domain: ClassVar[Domain] = Domain(u=(-math.pi / 2, math.pi / 2), v=(0.0, 2 * math.pi))
    edges: ClassVar[tuple[bool, bool]] = (False, False)  # u ends at poles, and v is periodic

    def position(self, u: Array, v: Array) -> Array:
        return jnp.stack(
            [
                self.r_x * cos(u) * cos(v),
                self.r_y * sin(u),
                self.r_z * cos(u) * sin(v),
            ],
            axis=-1,
        )
