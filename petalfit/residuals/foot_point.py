"""Foot points: the (u, v) of the places of a surface nearest to given points."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petalfit.surfaces import AbstractMap


def half_squared_distance(
    surface: AbstractMap, uv: Float[Array, "2"], x: Float[Array, "3"]
) -> Float[Array, ""]:
    """½ |S(u, v) − x|², for one point."""
    return 0.5 * jnp.sum((surface.position(uv[0], uv[1]) - x) ** 2)


def limits(surface: AbstractMap) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """The least and the greatest (u, v) of foot points; practically infinite where there is no edge."""
    low, high = (jnp.asarray(side, float) for side in zip(*surface.domain, strict=True))
    ends = np.asarray(surface.edges)
    return jnp.where(ends, low, -_ENDLESS), jnp.where(ends, high, _ENDLESS)


_ENDLESS = 1e6
_STILL = 1e-8  # a shorter step is not made: it changes a distance by its square


def newton(
    surface: AbstractMap,
    points: Float[Array, "n 3"],
    uv: Float[Array, "n 2"],
    iterations: int | Int[Array, ""],
) -> tuple[Float[Array, "n 2"], Float[Array, " n"], Float[Array, " n"]]:
    """Minimises |S(u, v) − x| over the domain for every point x, within its own local minimum.

    The method is Newton's with a Levenberg damping per point, whose quadratic model is minimised over the
    domain. Second derivatives are necessary: where the surface bends within the noise (ribs, the midrib's
    crest), Gauss-Newton does not converge.

    Args:
        surface: Any surface.
        points: The points x, in the surface's frame.
        uv: The start of every point, inside the domain.
        iterations: The number of steps; two from a good start, six from a coarse one.

    Returns:
        The foot points, a number for how doubtful each is (see `least_places`), and half the squared
        distances.
    """

    @jax.vmap
    def expand(uv: Array, x: Array) -> tuple[Array, Array, Array]:
        slope = jax.value_and_grad(lambda uv: half_squared_distance(surface, uv, x))
        along = jax.vmap(lambda direction: jax.jvp(slope, (uv,), (direction,)), out_axes=(None, 0))
        (value, gradient), (_, hessian) = along(jnp.eye(2, dtype=uv.dtype))
        return value, gradient, hessian

    return least_places(lambda uv: expand(uv, points), uv, iterations, *limits(surface))


def least_places(
    expand: Callable[[Array], tuple[Array, Array, Array]],
    uv: Float[Array, "n 2"],
    iterations: int | Array,
    low: Float[Array, "2"],
    high: Float[Array, "2"],
) -> tuple[Array, Array, Array]:
    """Places of least cost, by damped Newton steps for all points at once.

    Args:
        expand: Costs, their gradients and their Hessians at given places, shapes (n,), (n, 2), (n, 2, 2).
        uv: The start of every point.
        iterations: Upper bound of the steps; they end when no point moves any more.
        low: The least u and v.
        high: The greatest u and v.

    Returns:
        The places, a number for how doubtful each is, and the costs. Points that would still move are the
        most doubtful, followed by those that are weakly determined.
    """

    def goes_on(state: tuple) -> Array:
        count, _, move, *_ = state
        return (count <= iterations) & ((count == 0) | jnp.any(jnp.abs(move) > _STILL))

    def step(state: tuple) -> tuple:
        count, uv, move, _, value, gradient, hessian, damping = state
        trial = jnp.clip(uv + move, low, high)
        expansion = expand(trial)
        better = expansion[0] <= value
        uv, value, gradient, hessian = (
            jnp.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
            for new, old in zip((trial, *expansion), (uv, value, gradient, hessian), strict=True)
        )
        damping = jnp.where(better, 0.1 * damping, 8.0 * damping + 0.2)
        move, weakness = _newton_step(uv, gradient, hessian, damping, low, high)
        step = jnp.max(jnp.abs(move), axis=-1)
        doubt = jnp.where(step > 1e-6, 10.0 + step, weakness)
        return count + 1, uv, move, doubt, value, gradient, hessian, damping

    # The first pass only evaluates the expansion at the start.
    n = len(uv)
    flat = (jnp.full(n, jnp.inf), jnp.zeros((n, 2)), jnp.zeros((n, 2, 2)))
    state = (0, uv, jnp.zeros((n, 2)), jnp.zeros(n), *flat, jnp.zeros(n))
    _, uv, _, doubt, value, *_ = jax.lax.while_loop(goes_on, step, state)
    return uv, doubt, value


def _newton_step(
    uv: Array, gradient: Array, hessian: Array, damping: Array, low: Array, high: Array
) -> tuple[Array, Array]:
    """The step of each point to the minimum of a damped, convex quadratic model over the domain.

    The second result says how weakly each place is determined: minus the smallest eigenvalue of the
    scaled Hessian.
    """
    # The Hessian is scaled to a unit diagonal, [[a, t], [t, d]] with a, d = ±1, because u and v may
    # differ by orders of magnitude.
    root = jnp.sqrt(jnp.abs(jnp.diagonal(hessian, axis1=1, axis2=2)) + 1e-300)
    a, d = jnp.sign(hessian[:, 0, 0]), jnp.sign(hessian[:, 1, 1])
    t = hessian[:, 0, 1] / (root[:, 0] * root[:, 1])
    smallest = 0.5 * (a + d) - jnp.sqrt(0.25 * (a - d) ** 2 + t**2)
    shift = damping + jnp.where(smallest > 1e-9, 0.0, 1e-3 - 2 * smallest)
    a, d = a + shift, d + shift
    g_u, g_v = jnp.unstack(gradient / root, axis=1)
    low_u, low_v = jnp.unstack((low - uv) * root, axis=1)
    high_u, high_v = jnp.unstack((high - uv) * root, axis=1)
    determinant = a * d - t**2
    free_u, free_v = (t * g_v - d * g_u) / determinant, (t * g_u - a * g_v) / determinant
    # Where the free minimum lies outside, one coordinate stops at the edge and the other follows.
    u, v = jnp.clip(free_u, low_u, high_u), jnp.clip(free_v, low_v, high_v)
    leaves_u, leaves_v = u != free_u, v != free_v
    u = jnp.where(leaves_v & ~leaves_u, jnp.clip(-(g_u + t * v) / a, low_u, high_u), u)
    v = jnp.where(leaves_u, jnp.clip(-(g_v + t * u) / d, low_v, high_v), v)
    u = jnp.where(leaves_u & leaves_v, jnp.clip(-(g_u + t * v) / a, low_u, high_u), u)
    return jnp.stack([u, v], axis=-1) / root, -smallest
