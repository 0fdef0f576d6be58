"""The potential of a place across a strip, whose least value over all places is the strip's likelihood.

Points spread evenly over a strip of half width α and blurred by noise, both in units of τ, have at a
distance e from its middle the density Φ(α − e) − Φ(−α − e), which integrates to the width 2α. Its
negative logarithm g(e) is the least value over x of

    (e − x)²/2ρ + F(x; α, ρ),

where x is the distance of a place from the middle, and ρτ² the variance by which a point is held to its
place. A place that minimises the whole cost of its point therefore gives the right density, near one edge
of a wide surface as at a narrow tip, and the cost depends smoothly on everything else, by the envelope
theorem. F follows from g in closed form: with h = ∂g/∂e, the place is x = e − ρh(e), and F = g − ½ρh²,
∂F/∂x = h, ∂²F/∂x² = h'/(1 − ρh'), ∂F/∂α = ∂g/∂α, ∂F/∂ρ = ½h².
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Chebyshev, Polynomial

_STEPS = 3  # Newton steps for e
_NARROWEST = 1e-3  # half width; narrower strips count as wide


class Potential(NamedTuple):
    """The potential F of a strip, and its derivatives.

    Attributes:
        value: F.
        slope: ∂F/∂x.
        curvature: ∂²F/∂x².
        by_width: ∂F/∂α.
    """

    value: Float[Array, "*n"]
    slope: Float[Array, "*n"]
    curvature: Float[Array, "*n"]
    by_width: Float[Array, "*n"]


def potential(x: Float[Array, "*n"], half: Float[Array, "*n"], rho: Float[Array, ""]) -> Potential:
    """F(x; α, ρ) and its derivatives, for ρ < 1."""
    half = jnp.maximum(half, _NARROWEST)
    side = jnp.where(x < 0, -1.0, 1.0)
    e = _blurred_place(jnp.abs(x), half, rho)
    g, score, change, by_width = _strip(e, half)
    value = g - 0.5 * rho * score**2
    return Potential(value, side * score, change / (1.0 - rho * change), by_width)


def _strip(e: Array, half: Array) -> tuple[Array, Array, Array, Array]:
    """g, ∂g/∂e, ∂²g/∂e² and ∂g/∂α at e ≥ 0."""
    near, far = half - e, half + e  # distances inside the nearer and the farther edge
    beyond = jnp.minimum(near, 0.0)
    # Probabilities and densities times exp(beyond²/2), which keeps them finite far beyond the edge.
    near_edge, far_edge = (jnp.exp(0.5 * (beyond**2 - x**2)) for x in (near, far))
    outside = _tail(jnp.abs(near))
    inside = jnp.where(near < 0, outside, 1.0 - outside * near_edge) - _tail(far) * far_edge
    g = 0.5 * beyond**2 - jnp.log(inside)
    near_edge, far_edge = (x / (np.sqrt(2 * np.pi) * inside) for x in (near_edge, far_edge))
    score = near_edge - far_edge
    change = score**2 + near * near_edge + far * far_edge
    return g, score, jnp.clip(change, 0.0, 1.0), -(near_edge + far_edge)


def _tail(x: Array) -> Array:
    """Φ(−x) exp(x²/2) for x ≥ 0, to 1e-11: a polynomial in t = 3/(3 + x), which is smooth up to x = ∞."""
    t, value = 3.0 / (3.0 + x), jnp.zeros_like(x)
    for factor in _tail_factors()[::-1]:
        value = value * t + factor
    return t * value


@lru_cache(maxsize=1)
def _tail_factors() -> tuple[float, ...]:
    """The factors of 1, t, t², … in the polynomial of `_tail`, which interpolates SciPy's function."""
    from scipy.special import erfcx

    def of(t: np.ndarray) -> np.ndarray:
        return 0.5 * erfcx((3 / t - 3) / np.sqrt(2)) / t

    return tuple(Chebyshev.interpolate(of, 16, domain=(0, 1)).convert(kind=Polynomial).coef)


def _blurred_place(x: Array, half: Array, rho: Array) -> Array:
    """The e whose place is x ≥ 0, by Newton's method from a start near an edge or far inside."""
    beyond = x - half
    far = half + (beyond + jnp.sqrt(beyond**2 + 4 * rho * (1 - rho))) / (2 * (1 - rho))
    start = jnp.where(beyond > -0.45, far, x + rho * _strip(x, half)[1])

    def step(_: Array, e: Array) -> Array:
        _, score, change, _ = _strip(e, half)
        return jnp.maximum(e - (e - rho * score - x) / (1 - rho * change), 0.0)

    return jax.lax.fori_loop(0, _STEPS, step, start)
