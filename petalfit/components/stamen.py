"""The stamen, 2.3 of the paper: a filament that carries an anther."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from petalfit.components.assembly import AbstractAssembly
from petalfit.surfaces import (
    AbstractDeformedSurface,
    AbstractSurface,
    Cylinder,
    Domain,
    Ellipsoid,
    Pose,
    Scalar,
    about_x,
    angle,
    length,
)
from petalfit.surfaces.waves import cos, sin

_PI = jnp.pi


class Anther(AbstractDeformedSurface):
    """A saccate anther: an ellipsoid (r, 3r, r) swollen into two sacs, with a furrow between them.

    The paper says "expanded to become a saccate" and prints no formula. Here the swelling is n swell
    cos u |cos v|: two sacs at ±x, most swollen half-way along.
    """

    r: Scalar = length(0.8, "r", (0.05, 100.0), (0.2, 4.0), "radius of the ellipsoid")
    swell: Scalar = length(0.6, "a_1", (0.0, 50.0), (0.1, 2.0), "height of the sacs")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    @property
    def base(self) -> Ellipsoid:
        return Ellipsoid(self.r, 3 * self.r, self.r)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.asarray(self.swell * cos(u) * jnp.abs(cos(v)))


class Filament(AbstractDeformedSurface):
    """A long, thin, bent cylinder ("deformed cylinder" in the text of 2.3), open at both ends.

    The radius decreases from r at the base to r − taper at the tip. The bend adds a_2 sin(πv/2)² to z, so
    the filament is upright at its base.
    """

    r: Scalar = length(0.4, "r", (0.01, 50.0), (0.1, 2.0), "radius at the base")
    h: Scalar = length(20.0, "h", (0.5, 500.0), (5.0, 40.0), "height")
    a_2: Scalar = length(3.0, "a_2", (-100.0, 100.0), (-8.0, 8.0), "how far the tip leans")
    taper: Scalar = length(0.12, "a_1", (-5.0, 5.0), (0.0, 0.5), "how much thinner the tip is")
    domain: ClassVar[Domain] = Cylinder.domain
    orientation: ClassVar[float] = Cylinder.orientation
    regular: ClassVar[bool] = True
    edges: ClassVar[tuple[bool, bool]] = Cylinder.edges

    @property
    def base(self) -> Cylinder:
        return Cylinder(self.r, self.h)

    def offset(self, u: Array, v: Array) -> Array:
        lean = self.a_2 * sin(_PI * v / 2) ** 2
        zero = jnp.zeros_like(lean)
        return jnp.stack([zero, zero, lean], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.asarray(-self.taper * v)


class Stamen(AbstractAssembly):
    """A filament with an anther at its tip, which moves with the filament's height and lean.

    With `tilt` 0 the anther stands upright and the filament ends in its middle; with π/2 it lies across
    the tip, like the versatile anthers of a lily.

    Attributes:
        filament: The filament.
        anther: The anther.
    """

    filament: Filament = eqx.field(default_factory=Filament)
    anther: Anther = eqx.field(default_factory=Anther)
    # The range is half a turn, after which the anther is the same again.
    tilt: Scalar = angle(0.0, "τ", (-1.6, 1.6), (-1.5, 1.5), "how far the anther is tipped over")

    def parts(self) -> dict[str, tuple[Pose, AbstractSurface]]:
        filament = self.filament
        tip = Pose.at(0.0, filament.h, filament.a_2)
        return {
            "filament": (Pose.identity(), filament),
            "anther": (Pose(about_x(self.tilt), tip.translation, 1.0), self.anther),
        }
