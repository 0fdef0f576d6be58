"""Derivatives of a fit with respect to its data, by the implicit function theorem.

A converged fit solves F(t, data) = 0, where F is the gradient of its cost, so that
dt = −(∂F/∂t)⁻¹ ∂F/∂data. The iterations themselves are not differentiated. In F, foot points are
functions of t and of the data: they move when either changes, and are held where the edge of the petal
clamps them.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.likelihood.linearise import linearise
from petalfit.fitting.solver.solve import solve
from petalfit.residuals import (
    EDGE_NODES,
    Data,
    TangentDistance,
    edge_nodes,
    edge_pull,
    edge_score,
    estimate_sigma,
    frame,
    half_squared_distance,
    limits,
    pull_back,
    slide_foot_points,
)
from petalfit.surfaces import AbstractSurface


def solve_differentiably(
    coordinates: Coordinates,
    data: Data,
    t: Float[Array, " p"],
    uv: Float[Array, "n 2"],
    max_rounds: int = 100,
    tolerance: float = 1e-8,
) -> Float[Array, " p"]:
    """`solve` as a differentiable function of `data` and of the fixed parameters.

    Args:
        coordinates: The free parameters and the model that they belong to.
        data: The cloud; derivatives flow to its points, weights and, if given, its noise.
        t: Coordinates to start from, near the minimum.
        uv: Foot points to start from.
        max_rounds: Upper bound of the rounds; the theorem holds for a converged fit only.
        tolerance: Stop when the step is at most this many standard errors in every direction.

    Returns:
        The coordinates t of the minimum; `coordinates.values` turns them into parameters.
    """
    held = jax.lax.stop_gradient((coordinates, data, t, uv))
    seen = linearise(*held)
    term = TangentDistance(data=held[1], uv=held[3], sigma=seen.sigma)
    root = jnp.linalg.cholesky(seen.information + jnp.eye(len(t)))
    whitening = jnp.linalg.inv(root).T
    prior = Prior(jnp.zeros_like(t), jnp.zeros_like(t))
    settled = solve(held[0], (term,), prior, held[2], whitening, max_rounds, tolerance)
    settled = jax.lax.stop_gradient(settled)
    (term,) = settled.terms
    assert isinstance(term, TangentDistance)

    def gradient(t: Array) -> Array:
        return cost_gradient(coordinates, data, t, term.uv)

    def tangent_solve(linear, rhs: Array) -> Array:
        return jnp.linalg.solve(jax.vmap(linear, out_axes=1)(jnp.eye(len(rhs))), rhs)

    return jax.lax.custom_root(gradient, settled.t, lambda _, start: start, tangent_solve)


def cost_gradient(
    coordinates: Coordinates, data: Data, t: Float[Array, " p"], uv: Float[Array, "n 2"]
) -> Float[Array, " p"]:
    """Gradient of the cost that `solve` minimises, with differentiable foot points.

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
    sigma = estimate_sigma(data, distance, len(t))
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


def _implicit_foot_points(model: AbstractSurface, points: Array, uv: Array) -> Array:
    """Foot points with the right first derivatives, by one Newton step with a constant matrix."""
    uv = slide_foot_points(*jax.lax.stop_gradient((model, points, uv)), 8)
    low, high = limits(model)

    @jax.vmap
    def newton(uv: Array, x: Array) -> Array:
        gradient = jax.grad(half_squared_distance, 1)(model, uv, x)
        hessian = jax.hessian(half_squared_distance, 1)(model, uv, x)
        hessian = jax.lax.stop_gradient(hessian)
        moves = ((uv > low) | (gradient < 0)) & ((uv < high) | (gradient > 0))
        hessian = jnp.where(jnp.outer(moves, moves), hessian, jnp.diag(1.0 * ~moves))
        return uv - jnp.linalg.solve(hessian, jnp.where(moves, gradient, 0.0))

    return newton(uv, points)
