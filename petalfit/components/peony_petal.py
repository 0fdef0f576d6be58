"""The paper's peony petal, Eqs. 7 and 8."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from petalfit.surfaces import (
    AbstractDeformedSurface,
    Domain,
    Oscillation,
    Rectangle,
    Scalar,
    parameter,
)
from petalfit.surfaces.waves import sin

_PI = jnp.pi


class PeonyPetal(AbstractDeformedSurface):
    r"""A rectangle deformed into a peony petal (Eqs. 7 and 8 of the paper).

    With u ∈ [−½, ½] across and v ∈ [0, 1] along the petal::

        x  = a_x u + 0.8 a_x u sin(πv/2 − c)
        y  = b_y v + (v − ½)(1.5 a_x sin(π(u + ½)) + |3v sin(π a_x (u + ½)/6)|)
        Δg = rib_amplitude (1 − 2|v − ½|) sin(rib_frequency (u + ½)π)(1 − 2|u|)
             + midrib_height (1 − v)² exp(−midrib_sharpness u²)
             + dy sin(πy/40 − 1) + dx sin(πx/2 − ½) + tip_curl v³ sin(πx/8)
        z  = c_z + Δg

    In Δg, x and y are the values of the first two lines. The constants 40, 2 and 8 are lengths, so the
    equations assume a certain unit of length. Defaults are the constants that the paper prints; for a_x,
    b_y, c, dx and dy it prints none.
    """

    a_x: Scalar = parameter(
        14.0,
        symbol="a_x",
        unit="length",
        bounds=(1.0, 100.0),
        typical=(8.0, 28.0),
        meaning="width of the undeformed rectangle",
    )
    b_y: Scalar = parameter(
        22.0,
        symbol="b_y",
        unit="length",
        bounds=(1.0, 200.0),
        typical=(12.0, 44.0),
        meaning="length of the undeformed rectangle",
    )
    c_z: Scalar = parameter(
        0.0,
        symbol="c_z",
        unit="length",
        bounds=(-200.0, 200.0),
        typical=(-5.0, 5.0),
        meaning="section distance: height of the undeformed rectangle",
    )
    c: Scalar = parameter(
        0.6,
        symbol="c",
        unit="rad",
        bounds=(-2.5, 1.5),
        typical=(0.1, 1.1),
        meaning="phase of the widening from base to tip",
    )
    dx: Scalar = parameter(
        0.4,
        symbol="dx",
        unit="length",
        bounds=(-10.0, 10.0),
        typical=(-0.8, 0.8),
        meaning="amplitude of the waves across the petal",
    )
    dy: Scalar = parameter(
        3.0,
        symbol="dy",
        unit="length",
        bounds=(-50.0, 50.0),
        typical=(-6.0, 6.0),
        meaning="amplitude of the bend along the petal",
    )
    rib_frequency: Scalar = parameter(
        20.0,
        symbol="f",
        unit="1",
        bounds=(1.0, 64.0),
        typical=(4.0, 40.0),
        meaning="number of half waves of the ribs across the petal",
    )
    rib_amplitude: Scalar = parameter(
        0.3,
        symbol="A",
        unit="length",
        bounds=(-5.0, 5.0),
        typical=(0.0, 0.6),
        meaning="height of the ribs",
    )
    midrib_height: Scalar = parameter(
        3.0,
        symbol="h",
        unit="length",
        bounds=(-50.0, 50.0),
        typical=(0.0, 5.0),
        meaning="height of the midrib at the base",
    )
    midrib_sharpness: Scalar = parameter(
        800.0,
        symbol="s",
        unit="1",
        bounds=(20.0, 20000.0),
        typical=(200.0, 2000.0),
        meaning="decay of the midrib across the petal",
        fixed=True,
    )
    tip_curl: Scalar = parameter(
        2.0,
        symbol="t",
        unit="length",
        bounds=(-50.0, 50.0),
        typical=(-4.0, 4.0),
        meaning="amplitude of the curl towards the tip",
    )
    domain: ClassVar[Domain] = Rectangle.domain
    regular: ClassVar[bool] = True  # except at single points where a fold of the outline ends
    oscillation: ClassVar[Oscillation | None] = Oscillation("rib_frequency", "rib_amplitude")

    @property
    def shadow(self) -> PeonyPetal:
        """The petal flattened into the plane z = 0: its outline without any heights."""
        zero = np.float64(0.0)
        return dataclasses.replace(
            self, c_z=zero, dx=zero, dy=zero, rib_amplitude=zero, midrib_height=zero, tip_curl=zero
        )

    @property
    def base(self) -> Rectangle:
        return Rectangle(self.a_x, self.b_y, self.c_z)

    def offset(self, u: Array, v: Array) -> Array:
        a_x = self.a_x
        delta_x = 0.8 * a_x * u * sin(_PI * v / 2 - self.c)
        scallop = jnp.abs(3 * v * sin(_PI * a_x * (u + 0.5) / 6))
        delta_y = (v - 0.5) * (1.5 * a_x * sin(_PI * (u + 0.5)) + scallop)
        return jnp.stack([delta_x, delta_y, jnp.zeros_like(u)], axis=-1)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        x, y = point[..., 0], point[..., 1]
        envelope = (1 - 2 * jnp.abs(v - 0.5)) * (1 - 2 * jnp.abs(u))
        ribs = self.rib_amplitude * envelope * sin(self.rib_frequency * (u + 0.5) * _PI)
        midrib = self.midrib_height * (1 - v) ** 2 * jnp.exp(-self.midrib_sharpness * u**2)
        bend = self.dy * sin(_PI * y / 40 - 1)
        waves = self.dx * sin(_PI * x / 2 - 0.5)
        curl = self.tip_curl * v**3 * sin(_PI * x / 8)
        return jnp.asarray(ribs + midrib + bend + waves + curl)
