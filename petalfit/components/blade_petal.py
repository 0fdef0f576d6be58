"""A petal or leaf described in botanical terms: outline, bend, cup, twist and relief (Eq. 7)."""

from __future__ import annotations

import dataclasses
from types import ModuleType
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from petalfit.surfaces import (
    AbstractDeformedSurface,
    AbstractSurface,
    Domain,
    Rectangle,
    Scalar,
    angle,
    length,
    number,
)
from petalfit.surfaces.waves import cos, sin

# Gauss-Legendre nodes and weights on [0, 1], for the integrals along the midrib and across it.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(7)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1), 0.5 * _WEIGHTS
_SOFT = 0.01  # keeps the slope of an outline finite where it behaves like a square root
_KEEL = 0.12  # half width of the keel, in half widths of the blade
_GROOVE = 0.08  # half width of the midrib's relief, in half widths of the blade


def _angle(symbol: str, reach: float, typical: float, meaning: str) -> Any:
    return angle(0.0, symbol, (-reach, reach), (-typical, typical), meaning)


def _relief(symbol: str, meaning: str) -> Any:
    return length(0.0, symbol, (-5.0, 5.0), (-1.0, 1.0), meaning, fixed=True)


class BladePetal(AbstractDeformedSurface):
    r"""A lamina that is bent, cupped and twisted: Eq. 7 with deformations that have botanical names.

    With u ∈ [−½, ½] across, t = 2u, and v ∈ [0, 1] from base to tip:

    1. The outline lies in the plane: q = length · width · w(v)(u + skew u²) across and s = length ·
       (v − tip_edge v²σ² + base_edge (1 − v)²σ²) along, with σ = 2q/(length · width). An end is thus
       rounded or notched in proportion to its width, and no two places (u, v) coincide. w rises from
       `base_width` to 1 at v = `widest` and falls to `tip_width`. On each side it is
       e + (1 − e)(1 − ξ²)^taper, where e is the width of that end and ξ the distance from the widest
       place, as a fraction of that side. A taper of ½ gives an ellipse, 1 a parabola, 2 or more a claw
       or a drawn-out tip.
    2. The midrib bends without stretching: at x = s/length its angle to the base is bend x + 2 bend_shift
       x(x − 1) + tip_roll x⁸ out of the plane and sickle x within it, and the blade turns about it by
       twist x. Bends beyond a right angle are possible.
    3. Sections across the midrib curve without stretching: at σ the angle is κ(x)σ + margin_curl σ³ +
       keel tanh(σ/0.12); κ interpolates `cup_base`, `cup_mid` and `cup_tip`.
    4. With `relief`, heights are added along the unit normal of the bent blade: a midrib, ribs as in
       Eq. 8, and a ruffle of the margin, ruffle t²v cos(2π(ruffle_frequency v + ruffle_phase)).

    Every angle is the one between the two ends of what it bends: bend is the angle between the
    directions of base and tip, cup that between the directions of midrib and margin.

    Attributes:
        relief: Whether there are midrib, ribs and ruffle; fits without them are faster.
        sided: The names of the parameters that change sign when the blade is turned over.
    """

    length: Scalar = length(10.0, "L", (0.01, 1000.0), (3.0, 40.0), "along the midrib")
    width: Scalar = number(0.6, "w", (0.02, 3.0), (0.15, 1.2), "where it is widest, in lengths")
    widest: Scalar = number(0.5, "m", (0.08, 0.92), (0.25, 0.75), "where that is, from base to tip")
    base_width: Scalar = number(0.2, "e_b", (0.0, 1.0), (0.0, 0.6), "of the base, in widths")
    tip_width: Scalar = number(0.1, "e_t", (0.0, 1.0), (0.0, 0.6), "of the tip, in widths")
    base_taper: Scalar = number(0.8, "a_b", (0.15, 5.0), (0.4, 2.0), "½ round, 1 straight, 2 claw")
    tip_taper: Scalar = number(
        0.8, "a_t", (0.15, 5.0), (0.4, 2.0), "½ round, 1 straight, 2 drawn out"
    )
    tip_edge: Scalar = number(0.0, "τ_t", (-1.0, 1.0), (-0.2, 0.2), "rounded tip; < 0 notched")
    base_edge: Scalar = number(
        0.0, "τ_b", (-1.0, 1.0), (-0.2, 0.2), "rounded base; < 0 heart-shaped"
    )
    skew: Scalar = number(0.0, "k", (-0.9, 0.9), (-0.3, 0.3), "how much wider one side is")
    bend: Scalar = _angle("β", 6.3, 1.5, "of the midrib, towards the upper side")
    bend_shift: Scalar = _angle("β'", 6.3, 0.8, "more of it near the base, or (< 0) the tip")
    tip_roll: Scalar = _angle("β_t", 6.3, 0.5, "of the last part of the tip")
    sickle: Scalar = _angle("γ", 3.0, 0.3, "of the midrib, sideways")
    twist: Scalar = _angle("ω", 4.0, 0.4, "of the blade about its midrib")
    cup_base: Scalar = _angle("κ_b", 4.0, 1.0, "of the sections at the base")
    cup_mid: Scalar = _angle("κ_m", 4.0, 1.0, "half way")
    cup_tip: Scalar = _angle("κ_t", 4.0, 1.0, "at the tip")
    margin_curl: Scalar = _angle("μ", 4.0, 0.5, "of the margins alone")
    keel: Scalar = _angle("χ", 2.0, 0.3, "fold along the midrib")
    midrib: Scalar = _relief("h", "height of the midrib")
    rib_amplitude: Scalar = _relief("A", "height of the ribs")
    rib_frequency: Scalar = number(12.0, "f", (1.0, 64.0), (4.0, 40.0), "half waves of ribs", True)
    ruffle: Scalar = _relief("r", "height of the margin's waves")
    ruffle_frequency: Scalar = number(3.0, "f_r", (0.3, 20.0), (1.0, 8.0), "waves of it", True)
    ruffle_phase: Scalar = number(
        0.0, "φ_r", (-1.0, 1.0), (-0.5, 0.5), "their phase, in waves", True
    )
    relief: bool = eqx.field(default=False, static=True)
    # The parameters that change sign when the blade is turned over.
    sided: ClassVar[tuple[str, ...]] = (
        "skew",
        "bend",
        "bend_shift",
        "tip_roll",
        "sickle",
        "cup_base",
        "cup_mid",
        "cup_tip",
        "margin_curl",
        "keel",
        "midrib",
        "rib_amplitude",
        "ruffle",
    )
    domain: ClassVar[Domain] = Rectangle.domain
    regular: ClassVar[bool] = True

    @property
    def base(self) -> AbstractSurface:
        return _Bent(self)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        t = 2 * u
        midrib = self.midrib * (1 - v) ** 2 * jnp.exp(-((t / _GROOVE) ** 2))
        envelope = (1 - 2 * jnp.abs(v - 0.5)) * (1 - 2 * jnp.abs(u))
        ribs = self.rib_amplitude * envelope * sin(self.rib_frequency * (u + 0.5) * jnp.pi)
        waves = cos(2 * jnp.pi * (self.ruffle_frequency * v + self.ruffle_phase))
        return jnp.asarray(midrib + ribs + self.ruffle * t**2 * v * waves)

    def position(self, u: Array, v: Array) -> Array:
        if self.relief:
            return super().position(u, v)
        return bent(self, u, v)

    def reversed(self) -> BladePetal:
        """The blade with base and tip exchanged: in a frame at the tip, nearly the same surface.

        Of a flat blade the outline remains. A roll of the tip is lost, and relief stays as it is.
        """
        exchanged = {
            "widest": 1 - self.widest,
            "base_width": self.tip_width,
            "tip_width": self.base_width,
            "base_taper": self.tip_taper,
            "tip_taper": self.base_taper,
            "tip_edge": self.base_edge,
            "base_edge": self.tip_edge,
            "skew": -self.skew,
            "sickle": -self.sickle,
            "bend_shift": -self.bend_shift,
            "tip_roll": 0.0 * self.tip_roll,
            "cup_base": self.cup_tip,
            "cup_tip": self.cup_base,
        }
        return dataclasses.replace(self, **exchanged)

    def turned_over(self) -> BladePetal:
        """The blade with its upper side down: turned by π about y, it is the original blade again."""
        return eqx.tree_at(
            lambda petal: [getattr(petal, name) for name in self.sided],
            self,
            [-getattr(self, name) for name in self.sided],
        )


class _Bent(AbstractSurface):
    """The blade without its relief."""

    blade: BladePetal
    domain: ClassVar[Domain] = Rectangle.domain
    regular: ClassVar[bool] = True

    def position(self, u: Array, v: Array) -> Array:
        return bent(self.blade, u, v)


def profile(
    v: Any, widest: Scalar, ends: tuple[Any, Any], tapers: tuple[Any, Any], xp: ModuleType
) -> Any:
    """w(v), the width along an outline, relative to the greatest width.

    Args:
        v: Places from 0 at the base to 1 at the tip.
        widest: The place v of the greatest width.
        ends: The widths at base and tip.
        tapers: The tapers of the sides towards base and tip.
        xp: `jax.numpy`, or `numpy` for a search that makes many small calls.
    """
    below = v < widest
    end, taper = xp.where(below, *ends), xp.where(below, *tapers)
    inside = 1 - ((v - widest) / xp.where(below, widest, 1 - widest)) ** 2
    return end + (1 - end) * ((xp.maximum(inside, 0.0) + _SOFT) / (1 + _SOFT)) ** taper


def flat(blade: BladePetal, u: Array, v: Array) -> tuple[Array, Array]:
    """The coordinates q (across) and s (along) of the flat blade: step 1 of `BladePetal`."""
    ends, tapers = (blade.base_width, blade.tip_width), (blade.base_taper, blade.tip_taper)
    width = profile(v, blade.widest, ends, tapers, jnp)
    q = blade.length * blade.width * width * (u + blade.skew * u**2)
    sigma = 2 * q / (blade.length * blade.width)
    edges = blade.base_edge * (1 - v) ** 2 - blade.tip_edge * v**2
    return jnp.asarray(q), jnp.asarray(blade.length * (v + edges * sigma**2))


def bent(blade: BladePetal, u: Array, v: Array) -> Array:
    """The points of the blade without relief: steps 1 to 3 of `BladePetal`."""
    return bend(blade, *flat(blade, u, v))


def bend(blade: BladePetal, q: Array, s: Array) -> Array:
    """The points to which the places (q, s) of the flat blade move: steps 2 and 3 of `BladePetal`."""
    x, sigma = s / blade.length, 2 * q / (blade.length * blade.width)
    nodes, weights = jnp.asarray(_NODES, x.dtype), jnp.asarray(_WEIGHTS, x.dtype)

    def angles(x: Array) -> tuple[Array, Array]:
        out = blade.bend * x + 2 * blade.bend_shift * x * (x - 1) + blade.tip_roll * x**8
        return jnp.asarray(out), jnp.asarray(blade.sickle * x)

    phi, psi = angles(x[..., None] * nodes)
    along = jnp.stack([sin(psi), cos(psi) * cos(phi), cos(psi) * sin(phi)], axis=-1)
    midrib = s[..., None] * jnp.sum(weights[:, None] * along, axis=-2)
    phi, psi = angles(x)
    zero = jnp.zeros_like(x)
    lateral = jnp.stack([cos(psi), -sin(psi) * cos(phi), -sin(psi) * sin(phi)], axis=-1)
    normal = jnp.stack([zero, -sin(phi), cos(phi)], axis=-1)
    turn = (blade.twist * x)[..., None]
    lateral, normal = (
        lateral * cos(turn) + normal * sin(turn),
        normal * cos(turn) - lateral * sin(turn),
    )
    cup = (
        blade.cup_base * (1 - x) * (1 - 2 * x)
        + 4 * blade.cup_mid * x * (1 - x)
        + blade.cup_tip * x * (2 * x - 1)
    )
    across = sigma[..., None] * nodes
    angle = cup[..., None] * across + blade.margin_curl * across**3
    angle = angle + blade.keel * jnp.tanh(across / _KEEL)
    out = q * jnp.sum(weights * cos(angle), axis=-1)
    up = q * jnp.sum(weights * sin(angle), axis=-1)
    return midrib + out[..., None] * lateral + up[..., None] * normal
