"""Receptacles, Fig. 3: a cylinder, a cone, and the bowl of Eqs. 3 and 4."""

from __future__ import annotations

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces import (
    AbstractDeformedSurface,
    AbstractSurface,
    Domain,
    Ellipsoid,
    Scalar,
    length,
)
from petalfit.surfaces.waves import cos, sin


class CylinderReceptacle(AbstractSurface):
    """A closed cylinder with a rounded rim, its axis along y and its middle at 0: Fig. 3's first shape.

    It is the superellipse (r |cos u|^½, h/2 |sin u|^½), with the signs of cos u and sin u, rotated about
    y. The paper gives no equation.
    """

    r: Scalar = length(3.0, "r", (0.05, 100.0), (1.0, 10.0), "radius")
    h: Scalar = length(4.0, "h", (0.05, 200.0), (1.0, 12.0), "height")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    def position(self, u: Array, v: Array) -> Array:
        # The superellipse in a parametrisation that is smooth at its ends: (c, s)/(c⁴ + s⁴)^¼.
        cosine, sine = cos(u), sin(u)
        scale = (cosine**4 + sine**4) ** -0.25
        across, up = self.r * cosine * scale, 0.5 * self.h * sine * scale
        return jnp.stack([across * cos(v), up, across * sin(v)], axis=-1)


class ConeReceptacle(AbstractSurface):
    """A cone that stands on its tip, its axis along y, with a rounded top: Fig. 3's second shape.

    S = (r w cos v, y, r w sin v). For u < 0 it is the flank, w = 1 + 2u/π and y = h (w − 1), from the tip
    at −h to the rim; for u ≥ 0 the top, w = 1 − 2u/π and y = r (1 − w²)/4. The paper gives no equation.
    """

    r: Scalar = length(4.0, "r", (0.05, 100.0), (1.0, 10.0), "radius of the rim")
    h: Scalar = length(6.0, "h", (0.05, 200.0), (1.0, 15.0), "height from the tip to the rim")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    def position(self, u: Array, v: Array) -> Array:
        w = 1 - 2 * jnp.abs(u) / math.pi
        across = self.r * w
        up = jnp.where(u < 0, self.h * (w - 1), 0.25 * self.r * (1 - w**2))
        return jnp.stack([across * cos(v), up, across * sin(v)], axis=-1)


class Bowl(AbstractDeformedSurface):
    """The bowl-shaped receptacle of Eqs. 3 and 4, made of an ellipsoid (r, 3r, r) in two steps.

    First it swells by n r/2 |sin 2u| for u ≥ 0 and by n r/1.4 |sin 2u| for u < 0, along the ellipsoid's
    unit normal n. Then the half u ≥ 0 is hollowed. The paper prints that −r cos(π/2 − u) is added to z,
    which shears the top sideways instead of hollowing it; `hollow="printed"` does that. The default,
    "bowl", makes what Fig. 4(c) shows, "the upper part is changed to inside of bowl": it adds
    −5.5r cos(π/2 − u) to y, which turns the upper half down into the lower one and leaves a wall between
    them.

    Attributes:
        hollow: The way of hollowing, "bowl" or "printed".
    """

    r: Scalar = length(2.0, "r", (0.05, 100.0), (0.5, 8.0), "radius of the ellipsoid")
    hollow: str = eqx.field(default="bowl", static=True)
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    def __check_init__(self) -> None:
        if self.hollow not in ("bowl", "printed"):
            raise ValueError(f"hollow must be 'bowl' or 'printed'; received {self.hollow!r}")

    @property
    def base(self) -> Ellipsoid:
        return Ellipsoid(self.r, 3 * self.r, self.r)

    def offset(self, u: Array, v: Array) -> Array:
        down = jnp.where(u >= 0, -self.r * cos(jnp.pi / 2 - u), 0.0)
        zero = jnp.zeros_like(down)
        if self.hollow == "printed":
            return jnp.stack([zero, zero, down], axis=-1)
        return jnp.stack([zero, 5.5 * down, zero], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.where(u >= 0, self.r / 2, self.r / 1.4) * jnp.abs(sin(2 * u))
