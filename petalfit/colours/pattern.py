"""Patterns of intensity on a petal: centres, sides and rings (Eq. 9), and ribs (Eq. 10)."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

from petalfit.surfaces import Scalar, angle, broadcast_floats, number


class AbstractPattern(eqx.Module):
    """An intensity I₁ + I₂ s(u, v) on the petal's domain, u ∈ [−½, ½] and v ∈ [0, 1].

    A subclass defines the figure s and declares its parameters.
    """

    i_1: Scalar = number(0.0, "I_1", (-2.0, 3.0), (0.0, 0.6), "intensity of the ground")
    i_2: Scalar = number(1.0, "I_2", (-4.0, 4.0), (0.2, 1.0), "how much the pattern adds")

    @abc.abstractmethod
    def figure(
        self, u: Float[Array, "*shape"], v: Float[Array, "*shape"]
    ) -> Float[Array, "*shape"]:
        """The figure s(u, v), for u and v of the same shape."""

    def __call__(self, u: Real[ArrayLike, "..."], v: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
        """The intensities, not clipped to [0, 1], in the broadcast shape of u and v."""
        u, v = broadcast_floats(u, v)
        return jnp.asarray(self.i_1 + self.i_2 * self.figure(u, v))


class RadialPattern(AbstractPattern):
    """Rings along the petal, Eq. 9: I₁ + I₂ sinⁿ(v π f + φ).

    The paper says that the intensity runs from I₁ to I₂; as printed it runs to I₁ + I₂. The power of a
    negative sine is the real part of its principal value, |sin|ⁿ cos(πn), which agrees with the printed
    formula for every whole n and is continuous between them.
    """

    n: Scalar = number(2.0, "n", (0.05, 40.0), (0.5, 6.0), "sharpness of the rings")
    f: Scalar = number(1.0, "f", (0.02, 30.0), (0.3, 4.0), "rings, in half waves along the petal")
    phi: Scalar = angle(0.0, "φ", (-3.2, 3.2), (-1.6, 1.6), "phase at the base")

    def figure(self, u: Array, v: Array) -> Array:
        sine = jnp.sin(v * jnp.pi * self.f + self.phi)
        sign = jnp.where(sine < 0, jnp.cos(jnp.pi * self.n), 1.0)
        return sign * power(jnp.abs(sine), self.n)


class RibPattern(AbstractPattern):
    """Ribs across the petal, Eq. 10: I₁ + I₂ sin(f (u + ½) π) (1 − v)^n₁ v^n₂ (1 − 2|u|)^k.

    f is the number of half waves across the petal. n₁ and n₂ fade the ribs towards the tip and the base,
    k towards the sides.
    """

    f: Scalar = number(9.0, "f", (0.1, 120.0), (3.0, 40.0), "ribs, in half waves across")
    n_1: Scalar = number(0.5, "n_1", (0.0, 30.0), (0.0, 3.0), "how fast ribs fade to the tip")
    n_2: Scalar = number(0.5, "n_2", (0.0, 30.0), (0.0, 3.0), "how fast ribs fade to the base")
    k: Scalar = number(0.5, "k", (0.0, 30.0), (0.0, 3.0), "how fast ribs fade to the sides")

    def figure(self, u: Array, v: Array) -> Array:
        wave = jnp.sin(self.f * (u + 0.5) * jnp.pi)
        fade = power(1 - v, self.n_1) * power(v, self.n_2) * power(1 - 2 * jnp.abs(u), self.k)
        return wave * fade


def power(base: Array, exponent: Scalar) -> Array:
    """The power base^exponent for a base of at least 0, with finite derivatives at 0; 0⁰ is 1."""
    positive = base > 0
    at_zero = jnp.where(jnp.asarray(exponent) == 0, 1.0, 0.0)
    return jnp.where(positive, jnp.where(positive, base, 1.0) ** exponent, at_zero)
