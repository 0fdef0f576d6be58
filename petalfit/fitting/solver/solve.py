"""The compiled core of a fit: pure functions that maximise the likelihood from a start.

They can be jitted and mapped: shapes are static, and data are arguments. Derivatives of a fit with
respect to its data are in `petalfit.fitting.solver.implicit`.
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

# Levenberg-Marquardt starts with a damping of 1, and its variables have unit information. Residuals are
# multiplied by this factor, so that the first step is close to Gauss-Newton's.
_GAIN = 15.0
_FREE_ROUNDS = 8  # rounds with full steps


class State(NamedTuple):
    """The state of the compiled loop between two rounds.

    Attributes:
        t: Coordinates of the free parameters.
        terms: The terms of the cost, with foot points and noise of the last round.
        rounds: The number of rounds so far.
        moved: Length of the last step in standard errors, the largest over all directions.
        gain: The factor that residuals are multiplied by, in effect the inverse of the damping.
        shrunk: The noise relative to the noise at the start, the smallest ratio over the terms.
    """

    t: Float[Array, " p"]
    terms: tuple[AbstractTerm, ...]
    rounds: Int[Array, ""]
    moved: Float[Array, ""]
    gain: Float[Array, ""]
    shrunk: Float[Array, ""]


class _Round(NamedTuple):
    """The constants of one round: the terms with their foot points, and the linear part of the cost.

    The variables z of a round are the coordinates t whitened by the information at the start, so that
    one unit is about one standard error in every direction.
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
    """Minimises the costs of all terms and of the prior over the free parameters.

    Each round updates the foot points, and takes a few Levenberg-Marquardt steps on distances to them.

    Args:
        coordinates: The free parameters and the model that they belong to.
        terms: One term for each observation, with foot points and noise at the start.
        prior: The prior on the coordinates.
        t: Coordinates to start from.
        whitening: W, for which W Wᵀ is the inverse of the information at the start.
        max_rounds: Upper bound of the rounds.
        tolerance: Stop when the step is at most this many standard errors in every direction.

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
        # z is zero if no step lowered the cost: then damp more, until no damping is left to try.
        stuck = jnp.all(z == 0)
        nowhere = state.gain < _GAIN / 8**3
        moved = jnp.where(stuck & ~nowhere, jnp.inf, jnp.max(jnp.abs(z)))
        # Later steps are halved, which calms a foot point that flips between two rounds.
        z = jnp.where(state.rounds < _FREE_ROUNDS, z, 0.5 * z)
        gain = jnp.where(stuck, state.gain / 8, jnp.minimum(state.gain * 2, _GAIN))
        return State(held.place(z), renewed, state.rounds + 1, moved, gain, shrunk)

    infinite, gain = jnp.array(jnp.inf, t.dtype), jnp.array(_GAIN, t.dtype)
    start = State(t, terms, jnp.array(0), infinite, gain, jnp.ones((), t.dtype))
    return jax.lax.while_loop(go_on, one_round, jax.tree.map(jnp.asarray, start))


def _linear(coordinates: Coordinates, t: Array, pulls: tuple[Pull | None, ...]) -> Array:
    """Derivative with respect to t of the linear part of the cost, which consists of the pulls."""
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
    # The linear cost g·z is written as half the square of √(2K) + g·z/√(2K), less a constant; its
    # curvature vanishes for large K.
    root = jnp.sqrt(2 * _constant(observed))
    tilt = root + held.tilt @ z / root
    return held.gain * jnp.concatenate(
        [observed, tilt[None], held.prior.root * (t - held.prior.centre)]
    )


@_residuals.defjvp
def _residuals_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # One reverse pass per point gives all columns of the Jacobian; linearising `_residuals` column by
    # column would cost several times as much. Derivatives with respect to `held` are left out.
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
