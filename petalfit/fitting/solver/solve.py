"""The pure numerical core of a fit: from a start to the maximum of the likelihood.

Everything here can be jitted, mapped and differentiated; shapes are static, data are arguments.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from petalfit.compilation import Program
from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.residuals import AbstractFrozen, AbstractTerm, Pull, pull_back

# Levenberg-Marquardt starts with a damping of 1 and its variables have unit information, so residuals
# are multiplied by this for a first step close to Gauss-Newton's.
_GAIN = 15.0
_FREE_ROUNDS = 8


class State(NamedTuple):
    """The carry of the compiled loop.

    Attributes:
        t: Coordinates of the free parameters.
        terms: The terms, with foot points and noise of the last round.
        rounds: How many rounds were made.
        moved: The last round's step in units of the standard errors, the largest over the directions.
        gain: What residuals are multiplied by, in effect the inverse of the damping.
        shrunk: The noise in units of the noise at the start.
    """

    t: Float[Array, " p"]
    terms: tuple[AbstractTerm, ...]
    rounds: Int[Array, ""]
    moved: Float[Array, ""]
    gain: Float[Array, ""]
    shrunk: Float[Array, ""]


class _Round(NamedTuple):
    """What a round holds still: the terms with their foot points, and the linear part of the cost.

    A round's variables z are the coordinates t whitened by the information at the start, so that one
    unit is about one standard error in every direction.
    """

    coordinates: Coordinates
    parts: tuple[AbstractFrozen, ...]
    prior: Prior
    tilt: Array
    gain: Array
    origin: Array
    whitening: Array

    def place(self, z: Array) -> Array:
        return self.origin + self.whitening @ z


def solve(
    coordinates: Coordinates,
    terms: tuple[AbstractTerm, ...],
    prior: Prior,
    t: Float[Array, " p"],
    whitening: Float[Array, "p p"],
    max_rounds: int | Int[Array, ""],
    tolerance: float | Float[Array, ""],
) -> State:
    """Minimise the sum of the terms' costs and the prior's over the free parameters.

    Rounds alternate foot points with a few Levenberg-Marquardt steps on distances to them.

    Args:
        coordinates: Free parameters and the model that they belong to.
        terms: One for each observation; their foot points and noise belong to the start.
        prior: What is known without them.
        t: Start.
        whitening: W with W Wᵀ the inverse of the information at the start.
        max_rounds: Upper bound of the rounds.
        tolerance: Stop when no parameter moves by more than this many standard errors.

    Returns:
        The state after the last round. Its foot points belong to the parameters before the last step.
    """

    def go_on(state: State) -> Bool[Array, ""]:
        return (state.rounds < max_rounds) & ~(state.moved <= tolerance)

    def one_round(state: State) -> State:
        model = coordinates.model(state.t)
        renewed, parts, pulls = zip(*(x.freeze(model, len(t)) for x in state.terms), strict=True)
        ratios = [new.sigma / old.sigma for new, old in zip(renewed, terms, strict=True)]
        shrunk = jnp.min(jnp.stack(ratios))
        scaled = shrunk * whitening
        tilt = scaled.T @ _linear(coordinates, state.t, pulls)
        held = _Round(coordinates, parts, prior, tilt, state.gain, state.t, scaled)
        solution = optx.least_squares(
            _residuals,
            optx.LevenbergMarquardt(rtol=1e-2, atol=1e-2, linear_solver=lx.Normal(lx.Cholesky())),
            jnp.zeros_like(state.t),
            held,
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
        return State(held.place(z), renewed, state.rounds + 1, moved, gain, shrunk)

    infinite, gain = jnp.array(jnp.inf, t.dtype), jnp.array(_GAIN, t.dtype)
    start = State(t, terms, jnp.array(0), infinite, gain, jnp.ones((), t.dtype))
    return jax.lax.while_loop(go_on, one_round, jax.tree.map(jnp.asarray, start))


def _linear(coordinates: Coordinates, t: Array, pulls: tuple[Pull | None, ...]) -> Array:
    """Derivative of the pulls by t."""
    model, total = coordinates.model(t), jnp.zeros_like(t)
    for pull in pulls:
        if pull is not None:
            pulled = coordinates.gather(pull_back(model, pull.uv, pull.covectors))
            total = total + coordinates.slopes(t) * jnp.sum(pulled, axis=0)
    return total


@jax.custom_jvp
def _residuals(z: Array, held: _Round) -> Array:
    t = held.place(z)
    model = held.coordinates.model(t)
    observed = jnp.concatenate([part.residual(model) for part in held.parts])
    # A linear cost g·z as the square of √(2K) + g·z/√(2K), whose curvature vanishes for large K.
    root = jnp.sqrt(2 * _constant(observed))
    tilt = root + held.tilt @ z / root
    return held.gain * jnp.concatenate(
        [observed, tilt[None], held.prior.root * (t - held.prior.centre)]
    )


@_residuals.defjvp
def _residuals_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # All columns at once by one reverse pass per point; linearising `_residuals` column by column
    # would cost several times as much.
    z, held = primals
    return _residuals(z, held), _jacobian(z, held) @ tangents[0]


def _jacobian(z: Array, held: _Round) -> Array:
    t = held.place(z)
    model = held.coordinates.model(t)
    uv, covectors = zip(*(part.slopes(model) for part in held.parts), strict=True)
    pulled = pull_back(model, jnp.concatenate(uv), jnp.concatenate(covectors))
    rows = held.coordinates.gather(pulled) * held.coordinates.slopes(t)
    tilt = held.tilt / jnp.sqrt(2 * _constant(rows))
    prior = held.prior.root[:, None] * held.whitening
    return held.gain * jnp.concatenate([rows @ held.whitening, tilt[None], prior])


def _constant(rows: Array) -> float:
    return 1e3 + len(rows)


compiled_solve = Program(solve)
