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

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jaxtyping import Array, Float

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


@jax.custom_jvp
def strip_potential(
    x: Float[Array, "*n"], half: Float[Array, "*n"], rho: Float[Array, ""]
) -> Float[Array, "*n"]:
    """F(x; α, ρ), which autodiff differentiates once."""
    return potential(x, half, rho).value


@strip_potential.defjvp
def _strip_potential_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    here = potential(*primals)
    by_x, by_half, by_rho = tangents
    tangent = here.slope * by_x + here.by_width * by_half + 0.5 * here.slope**2 * by_rho
    return here.value, tangent


def _strip(e: Array, half: Array) -> tuple[Array, Array, Array, Array]:
    """g, ∂g/∂e, ∂²g/∂e² and ∂g/∂α at e ≥ 0."""
    near, far = half - e, half + e  # distances inside the nearer and the farther edge
    log_near = log_ndtr(near)
    inside = -jnp.expm1(log_ndtr(-far) - log_near)
    g = -log_near - jnp.log(inside)
    near_edge, far_edge = (jnp.exp(-0.5 * x**2 + g) / np.sqrt(2 * np.pi) for x in (near, far))
    score = near_edge - far_edge
    change = score**2 + near * near_edge + far * far_edge
    return g, score, jnp.clip(change, 0.0, 1.0), -(near_edge + far_edge)


def _blurred_place(x: Array, half: Array, rho: Array) -> Array:
    """The e whose place is x ≥ 0, by Newton's method from a start near an edge or far inside."""
    beyond = x - half
    far = half + (beyond + jnp.sqrt(beyond**2 + 4 * rho * (1 - rho))) / (2 * (1 - rho))
    start = jnp.where(beyond > -0.45, far, x + rho * _strip(x, half)[1])

    def step(_: Array, e: Array) -> Array:
        _, score, change, _ = _strip(e, half)
        return jnp.maximum(e - (e - rho * score - x) / (1 - rho * change), 0.0)

    return jax.lax.fori_loop(0, _STEPS, step, start)
