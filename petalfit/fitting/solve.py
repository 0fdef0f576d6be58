"""The pure numerical core of a cloud fit: from a start to the maximum of the likelihood.

Everything here can be jitted, mapped and differentiated; shapes are static, data are arguments.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.survey import Data, estimate_sigma
from petalfit.residuals import (
    EDGE_NODES,
    Frame,
    edge_nodes,
    edge_pull,
    edge_residual,
    edge_score,
    frame,
    pull_back,
    slide_foot_points,
)
from petalfit.surfaces import AbstractSurface

# Levenberg-Marquardt starts with a damping of 1 and its variables have unit information, so residuals
# are multiplied by this for a first step close to Gauss-Newton's.
_GAIN = 15.0
# Edges are looked at for the nearest quarter of the points, but never for fewer than this.
_FEW = 256
_FREE_ROUNDS = 8


class State(NamedTuple):
    """Where a fit stands.

    Attributes:
        t: Coordinates of the free parameters.
        uv: Foot points.
        sigma: Noise, given or estimated from the distances.
        rounds: How many rounds were made.
        moved: The last round's step in units of the standard errors, the largest over the directions.
        gain: What residuals are multiplied by, in effect the inverse of the damping.
    """

    t: Float[Array, " p"]
    uv: Float[Array, "n 2"]
    sigma: Float[Array, ""]
    rounds: Int[Array, ""]
    moved: Float[Array, ""]
    gain: Float[Array, ""]


class _Frozen(NamedTuple):
    """What a round holds still: foot points, their frames, and the linear part of the cost.

    A round's variables z are the coordinates t whitened by the information at the round's start, so
    that one unit is about one standard error in every direction.
    """

    coordinates: Coordinates
    data: Data
    uv: Array
    frame: Frame
    sigma: Array
    near: Array  # indices of the points that may lie near an edge
    tilt: Array
    gain: Array
    origin: Array
    whitening: Array

    def place(self, z: Array) -> Array:
        return self.origin + self.whitening @ z


def solve(
    coordinates: Coordinates,
    data: Data,
    t: Float[Array, " p"],
    uv: Float[Array, "n 2"],
    whitening: Float[Array, "p p"],
    max_rounds: int | Int[Array, ""],
    tolerance: float | Float[Array, ""],
) -> State:
    """Minimise Σ d²/2σ² − Σ log Φ(−e/σ) + Σ log Area over the free parameters.

    d are normal distances, e the distances beyond the edges (see `petalfit.residuals.edge`). Rounds
    alternate foot points with a few Levenberg-Marquardt steps on tangent distances to them; since the
    distance does not change when its foot point slides, the fixed point is the exact minimum.

    Args:
        coordinates: Free parameters and the model that they belong to.
        data: The cloud.
        t: Start.
        uv: Start of the foot points.
        whitening: From a `Survey` near the start.
        max_rounds: Upper bound of the rounds.
        tolerance: Stop when no parameter moves by more than this many standard errors.

    Returns:
        The state after the last round. Its `uv` belong to the parameters before the last step.
    """

    def go_on(state: State) -> Bool[Array, ""]:
        return (state.rounds < max_rounds) & ~(state.moved <= tolerance)

    def one_round(state: State) -> State:
        model = coordinates.model(state.t)
        uv = slide_foot_points(model, data.points, state.uv, 2)
        frozen = _freeze(coordinates, data, state.t, uv, whitening, state.gain)
        solution = optx.least_squares(
            _residuals,
            optx.LevenbergMarquardt(rtol=1e-2, atol=1e-2, linear_solver=lx.Normal(lx.Cholesky())),
            jnp.zeros_like(state.t),
            frozen,
            max_steps=6,
            throw=False,
        )
        z = jnp.where(jnp.isfinite(solution.value).all(), solution.value, 0.0)
        # No step was short enough to help: damp more, until there is nowhere to go.
        stuck = jnp.all(z == 0)
        nowhere = state.gain < _GAIN / 8**3
        moved = jnp.where(stuck & ~nowhere, jnp.inf, jnp.max(jnp.abs(z)))
        # Halved steps, later, calm a point that flips between two rounds.
        z = jnp.where(state.rounds < _FREE_ROUNDS, z, 0.5 * z)
        gain = jnp.where(stuck, state.gain / 8, jnp.minimum(state.gain * 2, _GAIN))
        return State(frozen.place(z), uv, frozen.sigma, state.rounds + 1, moved, gain)

    infinite, gain = jnp.array(jnp.inf, t.dtype), jnp.array(_GAIN, t.dtype)
    start = State(t, uv, data.sigma, jnp.array(0), infinite, gain)
    return jax.lax.while_loop(go_on, one_round, start)


def _freeze(
    coordinates: Coordinates, data: Data, t: Array, uv: Array, whitening: Array, gain: Array
) -> _Frozen:
    model = coordinates.model(t)
    nodes = jnp.asarray(edge_nodes(model.domain), uv.dtype)
    both = frame(model, jnp.concatenate([uv, nodes]))
    here, edge = (Frame(*(x[part] for x in both)) for part in (np.s_[: len(uv)], np.s_[len(uv) :]))
    sigma = estimate_sigma(data, here.distance(data.points), len(t))
    beyond = jnp.max(here.beyond(data.points), axis=-1)
    beyond = jnp.where(data.weights > 0, beyond, -jnp.inf)
    _, near = jax.lax.top_k(beyond, max(len(uv) // 4, min(len(uv), _FEW)))
    pull = edge_pull(model.domain, edge, uv, data.weights)
    pull = jnp.sum(coordinates.gather(pull_back(model, nodes[:EDGE_NODES], pull)), axis=0)
    whitening = sigma * whitening
    return _Frozen(
        coordinates,
        data,
        uv,
        here,
        sigma,
        near,
        whitening.T @ (coordinates.slopes(t) * pull),
        gain,
        t,
        whitening,
    )


@jax.custom_jvp
def _residuals(z: Array, frozen: _Frozen) -> Array:
    distance, beyond, _ = _decompose(z, frozen)
    edge = jnp.linalg.norm(edge_residual(beyond), axis=-1)
    return frozen.gain * jnp.concatenate(
        [
            jnp.sqrt(frozen.data.weights) * distance,
            jnp.sqrt(frozen.data.weights[frozen.near]) * edge,
            _tilt_residual(z, frozen)[None],
        ]
    )


@_residuals.defjvp
def _residuals_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # All columns at once by one reverse pass per point; linearising `_residuals` column by column
    # would cost several times as much.
    z, frozen = primals
    return _residuals(z, frozen), _jacobian(z, frozen) @ tangents[0]


def _decompose(z: Array, frozen: _Frozen) -> tuple[Array, Array, AbstractSurface]:
    """Distances, and edge distances of the near points, to the frozen frames, in units of σ."""
    model = frozen.coordinates.model(frozen.place(z))
    offset = frozen.data.points - model.position(frozen.uv[:, 0], frozen.uv[:, 1])
    distance = jnp.sum(frozen.frame.normal * offset, axis=-1)
    conormals, left = frozen.frame.conormals[frozen.near], frozen.frame.left[frozen.near]
    beyond = jnp.sum(conormals * offset[frozen.near, None, :], axis=-1) - left
    return distance / frozen.sigma, beyond / frozen.sigma, model


def _jacobian(z: Array, frozen: _Frozen) -> Array:
    _, beyond, model = _decompose(z, frozen)
    residual, score = edge_residual(beyond), edge_score(beyond)
    norm = jnp.linalg.norm(residual, axis=-1, keepdims=True)
    slope = jnp.where(norm > 0, score / jnp.where(norm > 0, norm, 1.0), 0.0)
    edge = jnp.sum(slope[..., None] * frozen.frame.conormals[frozen.near], axis=1)
    rows = jnp.concatenate([jnp.arange(len(frozen.uv)), frozen.near])
    root = jnp.sqrt(frozen.data.weights[rows]) / frozen.sigma
    covectors = -jnp.concatenate([frozen.frame.normal, edge]) * root[:, None]
    pulled = frozen.coordinates.gather(pull_back(model, frozen.uv[rows], covectors))
    pulled = pulled * frozen.coordinates.slopes(frozen.place(z)) @ frozen.whitening
    tilt = frozen.tilt / jnp.sqrt(2 * _constant(frozen))
    return frozen.gain * jnp.concatenate([pulled, tilt[None]])


def _constant(frozen: _Frozen) -> float:
    return 1e3 + len(frozen.uv)


def _tilt_residual(z: Array, frozen: _Frozen) -> Array:
    """A linear cost g·z as the square of √(2K) + g·z/√(2K), whose curvature vanishes for large K."""
    root = jnp.sqrt(2 * _constant(frozen))
    return root + frozen.tilt @ z / root
