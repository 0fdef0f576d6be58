"""The pistil, 2.3 of the paper: an ovary (Eq. 5), a style (Eq. 6) and a stigma; also compound ones."""

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
    about_y,
    length,
    number,
)
from petalfit.surfaces.waves import sin

_PI = jnp.pi


class Ovary(AbstractDeformedSurface):
    """An ovary, Eq. 5: an ellipsoid (r, 2r, r), bent in the middle by −r/2 sin(π/2 + u) along z."""

    r: Scalar = length(2.0, "r", (0.05, 100.0), (0.5, 8.0), "radius")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    @property
    def base(self) -> Ellipsoid:
        return Ellipsoid(self.r, 2 * self.r, self.r)

    def offset(self, u: Array, v: Array) -> Array:
        bend = -self.r / 2 * sin(_PI / 2 + u)
        zero = jnp.zeros_like(bend)
        return jnp.stack([zero, zero, bend], axis=-1)


class Style(AbstractDeformedSurface):
    """A style, Eq. 6: an uneven cylinder of radius r and height 10r that is bent in z.

    The swelling is sin(πv − 1) along the outward normal, the bend 3 sin(πv). Both are lengths, as
    printed, so a style with another r is not a scaled copy. The defaults of `swell`, `bend` and
    `slenderness` are the printed 1, 3 and 10.
    """

    r: Scalar = length(1.5, "r", (0.05, 100.0), (0.5, 6.0), "radius of the cylinder")
    swell: Scalar = length(1.0, "a_1", (-20.0, 20.0), (0.0, 2.0), "extent of the unevenness", True)
    bend: Scalar = length(3.0, "a_2", (-50.0, 50.0), (0.0, 6.0), "extent of the bend", True)
    slenderness: Scalar = number(
        10.0, "h/r", (0.5, 500.0), (5.0, 40.0), "height in radii", fixed=True
    )
    domain: ClassVar[Domain] = Cylinder.domain
    orientation: ClassVar[float] = Cylinder.orientation
    regular: ClassVar[bool] = True
    edges: ClassVar[tuple[bool, bool]] = Cylinder.edges

    @property
    def base(self) -> Cylinder:
        return Cylinder(self.r, self.slenderness * self.r)

    def offset(self, u: Array, v: Array) -> Array:
        bend = self.bend * sin(_PI * v)
        zero = jnp.zeros_like(bend)
        return jnp.stack([zero, zero, bend], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        return jnp.asarray(self.swell * sin(_PI * v - 1))


class Stigma(AbstractSurface):
    """A stigma: an ellipsoid, as in the text of 2.3, flattened along the style; half axes (r, h, r)."""

    r: Scalar = length(1.5, "r", (0.05, 100.0), (0.5, 6.0), "radius across")
    h: Scalar = length(0.8, "h", (0.02, 100.0), (0.2, 4.0), "half height")
    domain: ClassVar[Domain] = Ellipsoid.domain
    edges: ClassVar[tuple[bool, bool]] = Ellipsoid.edges

    def position(self, u: Array, v: Array) -> Array:
        return Ellipsoid(self.r, self.h, self.r).position(u, v)


class Pistil(AbstractAssembly):
    """A simple pistil, of one carpel: an ovary, a style on the ovary and a stigma on the style."""

    ovary: Ovary = eqx.field(default_factory=Ovary)
    style: Style = eqx.field(default_factory=lambda: Style(r=0.6, swell=0.25, bend=0.8))
    stigma: Stigma = eqx.field(default_factory=lambda: Stigma(r=1.0, h=0.6))

    def parts(self) -> dict[str, tuple[Pose, AbstractSurface]]:
        # The surfaces of Eqs. 5 and 6 end on the axis at both ends. The style begins slightly inside the
        # ovary and ends inside the stigma, so that no gap is visible.
        top = 4 * self.ovary.r - 0.5 * self.style.r
        return {
            "ovary": (Pose.at(0.0, 2 * self.ovary.r, 0.0), self.ovary),
            "style": (Pose.at(0.0, top, 0.0), self.style),
            "stigma": (Pose.at(0.0, top + self.style.base.h, 0.0), self.stigma),
        }


class CompoundPistil(AbstractAssembly):
    """A compound pistil, Fig. 5(b): carpels around one axis, so close together that they join.

    Every carpel is a pistil, turned about the axis and moved away from it by `spread` radii of its
    ovary. The ovaries and styles of neighbours run into one another; their stigmas form the lobes of one.

    Attributes:
        carpel: The pistil that every carpel is.
        carpels: The number of carpels, at least 2.
    """

    carpel: Pistil = eqx.field(default_factory=Pistil)
    spread: Scalar = number(
        0.6,
        "s",
        (0.0, 1.0),
        (0.3, 0.9),
        "distance of the carpels from the axis, in radii of the ovary",
    )
    carpels: int = eqx.field(default=3, static=True)

    def __check_init__(self) -> None:
        if self.carpels < 2:
            raise ValueError(f"a compound pistil has 2 carpels or more; received {self.carpels}")

    def parts(self) -> dict[str, tuple[Pose, AbstractSurface]]:
        carpel, found = self.carpel.parts(), {}
        # Styles stay nearer to the axis than ovaries; at the ovaries' distance they would come apart.
        away = self.spread * self.carpel.ovary.r
        near = jnp.minimum(jnp.asarray(away), 0.7 * jnp.asarray(self.carpel.style.r))
        for k in range(self.carpels):
            turn = about_y(2 * jnp.pi * k / self.carpels)
            for name, (pose, surface) in carpel.items():
                # Eq. 5 bends towards -z, so that side is the outer one.
                shift = Pose.at(0.0, 0.0, -(away if name == "ovary" else near))
                whole = Pose(turn, jnp.zeros(3), 1.0) @ shift @ pose
                found[f"carpel_{k + 1}/{name}"] = (whole, surface)
        return found
