"""Foot points: the (u, v) of the places of a surface nearest to given points."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from petalfit.surfaces import AbstractSurface


def nearest_nodes(surface: AbstractSurface, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """The nearest of 17 × 17 places of the domain for each point: coarse starts of foot points."""
    (u_low, u_high), (v_low, v_high) = surface.domain
    fraction = (np.arange(_NODES) + 0.5) / _NODES
    u, v = np.meshgrid(fraction, fraction, indexing="ij")
    u, v = u_low + (u_high - u_low) * u.ravel(), v_low + (v_high - v_low) * v.ravel()
    nodes = surface.position(jnp.asarray(u), jnp.asarray(v))
    squares = jnp.sum(nodes**2, axis=-1)
    # Computed in batches, because all squared distances of a large cloud would take gigabytes.
    index = jax.lax.map(
        lambda x: jnp.argmin(squares - 2.0 * nodes @ x), points, batch_size=min(len(points), 4096)
    )
    return jnp.stack([jnp.asarray(u)[index], jnp.asarray(v)[index]], axis=-1)


def slide_foot_points(
    surface: AbstractSurface,
    points: Float[Array, "n 3"],
    uv: Float[Array, "n 2"],
    iterations: int | Int[Array, ""],
) -> Float[Array, "n 2"]:
    """Refines foot points within their own local minima; see `refine_foot_points`."""
    return _newton(surface, points, uv, iterations)[0]


def refine_foot_points(
    surface: AbstractSurface,
    points: Float[Array, "n 3"],
    uv: Float[Array, "n 2"],
    iterations: int | Int[Array, ""],
    around: bool | Bool[Array, ""] = True,
) -> Float[Array, "n 2"]:
    """Minimises |S(u, v) − x| over the surface's domain for every point, from the starts `uv`.

    The method is Newton's with a Levenberg damping per point, whose quadratic model is minimised over the
    domain. Second derivatives are necessary: where the surface bends within the noise (ribs, the midrib's
    crest), Gauss-Newton does not converge. Two kinds of points then search for a better minimum. Those
    that still move or are weakly determined (between two layers that meet at a fold, or two ribs) search
    nearby; the farthest points search everywhere.

    Args:
        surface: Any surface.
        points: The points x, in the surface's frame.
        uv: The start of every point, inside the domain.
        iterations: The number of Newton steps; two from a good start, six from a coarse one.
        around: Whether points search for a better minimum at all.

    Returns:
        Foot points, never farther from `points` than `uv` was.
    """
    uv, doubt, squared = _newton(surface, points, uv, iterations)
    return jax.lax.cond(
        around, lambda: _looked_around(surface, points, uv, doubt, squared), lambda: uv
    )


def _looked_around(
    surface: AbstractSurface, points: Array, uv: Array, doubt: Array, squared: Array
) -> Array:
    """Foot points, improved where the doubtful and the farthest points find better minima."""
    n = len(uv)
    _, doubtful = jax.lax.top_k(doubt, min(n, max(32, n // 32)))
    _, far = jax.lax.top_k(squared, min(n, max(32, n // 64)))
    which = jnp.concatenate([doubtful, far])
    places = [_places_nearby(surface, uv[doubtful]), _places_to_look(surface, points[far])]
    starts = jnp.concatenate([uv[which][None], jnp.concatenate(places, axis=1)])
    rows = jnp.tile(points[which], (len(starts), 1))
    found, _, reached = _newton(surface, rows, starts.reshape(-1, 2), 8)
    reached = reached.reshape(starts.shape[:2])
    closest, column = jnp.argmin(reached, axis=0), jnp.arange(len(which))
    better = reached[closest, column] < squared[which]
    found = found.reshape(starts.shape)[closest, column]
    return uv.at[which].set(jnp.where(better[:, None], found, uv[which]))


def _places_nearby(surface: AbstractSurface, uv: Array) -> Array:
    """Starts on all four sides of given places, shape (4, n, 2)."""
    low, high = (jnp.asarray(side, uv.dtype) for side in zip(*surface.domain, strict=True))
    sides = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    return jnp.clip(uv + 0.04 * (high - low) * sides[:, None], low, high)


def half_squared_distance(
    surface: AbstractSurface, uv: Float[Array, "2"], x: Float[Array, "3"]
) -> Float[Array, ""]:
    """½ |S(u, v) − x|², for one point."""
    return 0.5 * jnp.sum((surface.position(uv[0], uv[1]) - x) ** 2)


def _places_to_look(surface: AbstractSurface, points: Array) -> Array:
    """Starts in four different parts of the domain, shape (4, n, 2): the nearest node of each part.

    Where a surface folds over itself, the nearest node of all may lie on the wrong layer.
    """
    (u_low, u_high), (v_low, v_high) = surface.domain
    fraction = (jnp.arange(32) + 0.5) / 32
    u, v = u_low + (u_high - u_low) * fraction, v_low + (v_high - v_low) * fraction
    uv = jnp.stack(jnp.meshgrid(u, v, indexing="ij"), axis=-1)
    uv = uv.reshape(8, 4, 8, 4, 2).transpose(0, 2, 1, 3, 4).reshape(64, 16, 2)  # parts, nodes
    nodes = surface.position(uv[..., 0], uv[..., 1])

    def look(x: Array) -> Array:
        squared = jnp.sum(nodes**2, axis=-1) - 2.0 * nodes @ x
        _, parts = jax.lax.top_k(-jnp.min(squared, axis=-1), 4)
        return uv[parts, jnp.argmin(squared[parts], axis=-1)]

    starts = jax.lax.map(look, points, batch_size=min(len(points), 256))
    return jnp.swapaxes(starts, 0, 1)


def limits(surface: AbstractSurface) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """The least and the greatest (u, v) of foot points; practically infinite where there is no edge."""
    low, high = (jnp.asarray(side, float) for side in zip(*surface.domain, strict=True))
    ends = np.asarray(surface.edges)
    return jnp.where(ends, low, -_ENDLESS), jnp.where(ends, high, _ENDLESS)


_ENDLESS = 1e6
_NODES = 17


def _newton(
    surface: AbstractSurface, points: Array, uv: Array, iterations: int | Array
) -> tuple[Array, Array, Array]:
    """Foot points, a number for how doubtful each is, and half the squared distances."""

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
        iterations: The number of steps.
        low: The least u and v.
        high: The greatest u and v.

    Returns:
        The places, a number for how doubtful each is, and the costs. Points that would still move are the
        most doubtful, followed by those that are weakly determined.
    """

    def step(_: Array, state: tuple) -> tuple:
        uv, move, _, value, gradient, hessian, damping = state
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
        return uv, move, doubt, value, gradient, hessian, damping

    # The first pass only evaluates the expansion at the start.
    n = len(uv)
    flat = (jnp.full(n, jnp.inf), jnp.zeros((n, 2)), jnp.zeros((n, 2, 2)))
    state = (uv, jnp.zeros((n, 2)), jnp.zeros(n), *flat, jnp.zeros(n))
    uv, _, doubt, value, *_ = jax.lax.fori_loop(0, iterations + 1, step, state)
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
