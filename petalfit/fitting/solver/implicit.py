"""Derivatives of a fit with respect to its data, by the implicit function theorem.

A converged fit solves F(t, data) = 0, where F is the gradient of its cost, so that
dt = −(∂F/∂t)⁻¹ ∂F/∂data. The iterations themselves are not differentiated. In F, foot points are
functions of t and of the data: they move when either changes, and are held where the edge of the petal
clamps them.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.residuals import (
    EDGE_NODES,
    Data,
    edge_nodes,
    edge_pull,
    edge_score,
    frame,
    half_squared_distance,
    limits,
    newton,
    pull_back,
)
from petalfit.surfaces import AbstractSurface


def solve_differentiably(
    coordinates: Coordinates,
    data: Data,
    t: Float[Array, " p"],
    uv: Float[Array, "n 2"],
    max_steps: int = 100,
    tolerance: float = 1e-8,
) -> Float[Array, " p"]:
    """The end of a fit as a differentiable function of `data` and of the fixed parameters.

    Args:
        coordinates: The free parameters and the model that they belong to.
        data: The cloud, in arrays of jax; derivatives flow to its points, weights and, if given, its
            noise.
        t: Coordinates to start from, near the minimum.
        uv: Foot points to start from.
        max_steps: Upper bound of the steps; the theorem holds for a converged fit only.
        tolerance: Stop when t and the gradient of the cost change by less than this, relative to 1 and
            to their size. The steps converge quadratically, so the last error is far smaller; rounding
            of the gradient forbids much less.

    Returns:
        The coordinates t of the minimum; `coordinates.values` turns them into parameters.

    Raises:
        RuntimeError: The steps do not converge.
    """
    start, uv = jax.lax.stop_gradient((t, uv))
    leaves, structure = jax.tree.flatten((coordinates, data))

    def gradient(t: Array, leaves: list[Array]) -> Array:
        coordinates, data = jax.tree.unflatten(structure, leaves)
        return cost_gradient(coordinates, data, t, uv)

    found = optx.root_find(
        gradient,
        optx.Newton(rtol=tolerance, atol=tolerance),
        start,
        args=leaves,
        max_steps=max_steps,
    )
    return found.value


def cost_gradient(
    coordinates: Coordinates, data: Data, t: Float[Array, " p"], uv: Float[Array, "n 2"]
) -> Float[Array, " p"]:
    """Gradient of the cost that a fit minimises, with differentiable foot points.

    Args:
        coordinates: The free parameters and the model that they belong to.
        data: The cloud.
        t: Coordinates of the free parameters.
        uv: Approximate foot points.
    """
    model = coordinates.model(t)
    uv = _implicit_foot_points(model, data.points, uv)
    here = frame(model, uv)
    distance = here.distance(data.points)
    sigma = jnp.where(jnp.isnan(data.sigma), _estimated(data, distance, len(t)), data.sigma)
    beyond = here.beyond(data.points) / sigma
    score = edge_score(beyond)
    covectors = here.normal * (distance / sigma)[:, None]
    covectors = (covectors + jnp.sum(score[..., None] * here.conormals, axis=1)) / sigma
    nodes = jnp.asarray(edge_nodes(model.domain), uv.dtype)
    farthest = jnp.max(beyond, axis=-1)
    pull = edge_pull(model, frame(model, nodes), uv, data.weights, farthest, sigma)
    pulled = pull_back(
        model,
        jnp.concatenate([uv, nodes[:EDGE_NODES]]),
        jnp.concatenate([-data.weights[:, None] * covectors, pull]),
    )
    return jnp.sum(coordinates.gather(pulled), axis=0) * jnp.asarray(coordinates.slopes(t))


def _estimated(data: Data, distance: Float[Array, " n"], free: int) -> Float[Array, ""]:
    """The noise that a fit of so many parameters estimates, see `estimated_noise`."""
    square = jnp.sum(data.weights * distance**2)
    return jnp.sqrt(square / jnp.maximum(jnp.sum(data.weights) - free, 1))


def _implicit_foot_points(model: AbstractSurface, points: Array, uv: Array) -> Array:
    """Foot points with the right first derivatives, by one Newton step with a constant matrix."""
    uv, _, _ = newton(*jax.lax.stop_gradient((model, points, uv)), 8)
    low, high = limits(model)

    @jax.vmap
    def step(uv: Array, x: Array) -> Array:
        gradient = jax.grad(half_squared_distance, 1)(model, uv, x)
        hessian = jax.hessian(half_squared_distance, 1)(model, uv, x)
        hessian = jax.lax.stop_gradient(hessian)
        moves = ((uv > low) | (gradient < 0)) & ((uv < high) | (gradient > 0))
        hessian = jnp.where(jnp.outer(moves, moves), hessian, jnp.diag(1.0 * ~moves))
        return uv - jnp.linalg.solve(hessian, jnp.where(moves, gradient, 0.0))

    return step(uv, points)
