"""The sepal, a small petal: Eq. 7 with its own deformations."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces import AbstractDeformedSurface, Domain, Rectangle, Scalar, length, parameter
from petalfit.surfaces.waves import cos

_PI = jnp.pi


class Sepal(AbstractDeformedSurface):
    """A pointed, cupped leaf: the rectangle of Eq. 7 with Δx, Δg and Δy = 0.

    The paper says that petal and sepal are similar and gives only the petal. This sepal narrows towards
    the tip by Δx = a_x u (cos(c v)² − 1), and is cupped and bent by Δg = cup (4u² − 1) + bend v².
    """

    a_x: Scalar = length(8.0, "a_x", (0.2, 100.0), (3.0, 16.0), "width at the base")
    b_y: Scalar = length(14.0, "b_y", (0.2, 200.0), (6.0, 30.0), "length")
    c: Scalar = parameter(
        1.2,
        symbol="c",
        unit="rad",
        bounds=(0.0, 1.5),
        typical=(0.7, 1.4),
        meaning="how far the width falls to the tip",
    )
    cup: Scalar = length(1.2, "g_1", (-30.0, 30.0), (-3.0, 3.0), "depth of the cup across")
    bend: Scalar = length(2.0, "g_2", (-60.0, 60.0), (-6.0, 6.0), "rise of the tip")
    domain: ClassVar[Domain] = Rectangle.domain
    regular: ClassVar[bool] = True

    @property
    def base(self) -> Rectangle:
        return Rectangle(self.a_x, self.b_y, 0.0)

    def offset(self, u: Array, v: Array) -> Array:
        narrowing = self.a_x * u * (cos(self.c * v) ** 2 - 1)
        zero = jnp.zeros_like(narrowing)
        return jnp.stack([narrowing, zero, zero], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.asarray(self.cup * (4 * u**2 - 1) + self.bend * v**2)
