"""Parts of the pistil, 2.3 of the paper: ovary (Eq. 5), style (Eq. 6), stigma."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces import (
    AbstractDeformedSurface,
    AbstractSurface,
    Cylinder,
    Domain,
    Ellipsoid,
    Scalar,
    length,
)

_PI = jnp.pi


class Ovary(AbstractDeformedSurface):
    """Eq. 5: an ellipsoid (r, 2r, r) with z − r/2 sin(π/2 + u), bent to one side in the middle."""

    r: Scalar = length(2.0, "r", (0.05, 100.0), (0.5, 8.0), "radius")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    @property
    def base(self) -> Ellipsoid:
        return Ellipsoid(self.r, 2 * self.r, self.r)

    def offset(self, u: Array, v: Array) -> Array:
        bend = -self.r / 2 * jnp.sin(_PI / 2 + u)
        zero = jnp.zeros_like(bend)
        return jnp.stack([zero, zero, bend], axis=-1)


class Style(AbstractDeformedSurface):
    """Eq. 6: a cylinder of radius r and height 10r, uneven, and bent in z.

    Swelling sin(πv − 1) along the outward normal, bend 3 sin(πv); both are lengths as printed, so that a
    style of another r is no scaled copy. `swell` and `bend` have the printed 1 and 3.
    """

    r: Scalar = length(1.5, "r", (0.05, 100.0), (0.5, 6.0), "radius of the cylinder")
    swell: Scalar = length(1.0, "a_1", (-20.0, 20.0), (0.0, 2.0), "extent of the unevenness", True)
    bend: Scalar = length(3.0, "a_2", (-50.0, 50.0), (0.0, 6.0), "extent of the bend", True)
    domain: ClassVar[Domain] = Cylinder.domain
    orientation: ClassVar[float] = Cylinder.orientation
    regular: ClassVar[bool] = True
    edges: ClassVar[tuple[bool, bool]] = Cylinder.edges

    @property
    def base(self) -> Cylinder:
        return Cylinder(self.r, 10 * self.r)

    def offset(self, u: Array, v: Array) -> Array:
        bend = self.bend * jnp.sin(_PI * v)
        zero = jnp.zeros_like(bend)
        return jnp.stack([zero, zero, bend], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.asarray(self.swell * jnp.sin(_PI * v - 1))


class Stigma(AbstractSurface):
    """An ellipsoid, as the text of 2.3 says, flattened along the style: half axes (r, h, r)."""

    r: Scalar = length(1.5, "r", (0.05, 100.0), (0.5, 6.0), "radius across")
    h: Scalar = length(0.8, "h", (0.02, 100.0), (0.2, 4.0), "half height")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    def position(self, u: Array, v: Array) -> Array:
        return Ellipsoid(self.r, self.h, self.r).position(u, v)
