"""The compiled programs of a cloud fit, each a pure function of arrays of a bucketed size."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.components import PeonyPetal
from petalfit.fitting import peony_start
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.solve import Data, State, information, solve
from petalfit.residuals import (
    distance_score,
    frame,
    nearest_nodes,
    perturbations,
    refine_foot_points,
)
from petalfit.surfaces import AbstractSurface


class Finish(NamedTuple):
    """What is known when a fit has settled.

    Attributes:
        values: The free parameters, with the bias that curvature and noise cause removed.
        information: Their Fisher information.
        distance: Signed normal distances, shape (n,).
        beyond: Distance beyond the nearer edges, positive outside, shape (n,).
        uv: Foot points, shape (n, 2).
    """

    values: Float[Array, " p"]
    information: Float[Array, "p p"]
    distance: Float[Array, " n"]
    beyond: Float[Array, " n"]
    uv: Float[Array, "n 2"]


# Few and shared, because compiling them is what a first fit waits for.
solve_compiled = jax.jit(solve)
fit_outline = jax.jit(peony_start.fit_outline)
fit_heights = jax.jit(peony_start.fit_heights)
find_ribs = jax.jit(peony_start.rib_periodogram)
nearest = jax.jit(nearest_nodes)
refine = jax.jit(refine_foot_points)


def plane_feet(petal: PeonyPetal, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """(u, v) of a petal straight below or above the points: a start for their foot points.

    Sought at the nearest place of the surface itself, many would end on the wrong rib.
    """
    flat = peony_start.flat(petal)
    below = points * jnp.array([1.0, 1.0, 0.0])
    return refine(flat, below, nearest(flat, below), 6)


def finish(coordinates: Coordinates[PeonyPetal], data: Data, state: State, sample: Data) -> Finish:
    """Remove the bias, and look at the result with converged foot points.

    Args:
        coordinates: The free parameters.
        data: The cloud.
        state: Where the solver stopped.
        sample: The cloud, or a part of it that is large enough to measure the bias on.
    """
    model = coordinates.model(state.t)
    uv = refine(model, data.points, state.uv, 1)
    places = uv
    if sample is not data:
        places = refine(model, sample.points, plane_feet(model, sample.points), 3)
    scores = [
        _distance_score(model, points, refine(model, points, places, 3), sample.weights)
        for points in _perturbations(model, places, state.sigma)
    ]
    t, matrix = _unbiased(coordinates, data, state.t, uv, scores, sample.weights)
    # The foot points move only along the surface, which changes no distance to first order.
    distance, beyond = _distances(coordinates.model(t), data.points, uv)
    return Finish(coordinates.values(t), matrix, distance, beyond, uv)


_perturbations = jax.jit(perturbations)
_distance_score = jax.jit(distance_score)


@jax.jit
def _unbiased(
    coordinates: Coordinates,
    data: Data,
    t: Array,
    uv: Array,
    scores: list[AbstractSurface],
    sample_weights: Array,
) -> tuple[Array, Array]:
    """Coordinates moved by the bias, and the information of the free parameters there."""
    matrix, sigma = information(coordinates, data, t, uv)
    share = jnp.sum(sample_weights) / jnp.sum(data.weights)
    score = 0.5 * sum(coordinates.gather(score) for score in scores) / (share * sigma**2)
    ridge = jnp.eye(len(t))  # the information of the typical ranges
    step = jnp.linalg.solve(matrix + ridge, coordinates.slopes(t) * score)
    # A bias of more than a few standard errors is not a small correction any more.
    size = jnp.sqrt(step @ matrix @ step / len(step))
    moved = t + step * jnp.minimum(1.0, 3.0 / jnp.maximum(size, 1e-300))
    slopes = coordinates.slopes(t)
    return jnp.where(jnp.isfinite(moved).all(), moved, t), matrix / jnp.outer(slopes, slopes)


@jax.jit
def _distances(model: AbstractSurface, points: Array, uv: Array) -> tuple[Array, Array]:
    """Normal distances, and distances beyond the nearer edges."""
    here = frame(model, uv)
    offset = points - here.position
    beyond = jnp.sum(here.conormals * offset[:, None, :], axis=-1) - here.left
    return jnp.sum(here.normal * offset, axis=-1), jnp.max(beyond, axis=-1)
