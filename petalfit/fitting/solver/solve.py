"""The core of a fit: rounds of Levenberg-Marquardt steps that maximise the likelihood from a start.

All that depends on the surface is computed by a few compiled programs, which all fits of that kind of
surface share. The steps themselves have as many unknowns as there are parameters, and are left to NumPy.
A program of the whole loop would be compiled for every form of a problem, which takes longer than the
fit. Derivatives of a fit with respect to its data are in `petalfit.fitting.solver.implicit`.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.likelihood.linearise import slopes_at
from petalfit.residuals import AbstractFrozen, AbstractTerm, Pull, places
from petalfit.surfaces import AbstractSurface

# Levenberg-Marquardt starts with a damping of 1, and its variables have unit information. Residuals are
# multiplied by this factor, so that the first step is close to Gauss-Newton's.
_GAIN = 15.0
_FREE_ROUNDS = 8  # rounds with full steps
_STEPS = 5  # in a round
# A smaller change of all variables and residuals, relative to 1 and to their size, ends a round.
_ENOUGH = 1e-2
# A step is taken if it lowers the cost by this share of what was expected, and damping changes after a
# step that was not taken, and after one that lowered the cost nearly as expected.
_TAKEN, _AS_EXPECTED, _MORE, _LESS = 0.01, 0.99, 4.0, 1 / 3.5


class State(NamedTuple):
    """Where the rounds have ended.

    Attributes:
        t: Coordinates of the free parameters.
        terms: The terms of the cost, with foot points and noise of the last round.
        rounds: The number of rounds.
        moved: Length of the last step in standard errors, the largest over all directions.
        shrunk: The noise relative to the noise at the start, the smallest ratio over the terms.
    """

    t: Float[np.ndarray, " p"]
    terms: tuple[AbstractTerm, ...]
    rounds: int
    moved: float
    shrunk: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Round:
    """The constants of one round: the terms with their foot points, and the linear part of the cost.

    The variables z of a round are the coordinates t whitened by the information at the start, so that
    one unit is about one standard error in every direction.
    """

    coordinates: Coordinates
    parts: tuple[AbstractFrozen, ...]
    prior: Prior
    tilt: Float[np.ndarray, " p"]
    gain: float
    origin: Float[np.ndarray, " p"]
    whitening: Float[np.ndarray, "p p"]

    @cached_property
    def uv(self) -> Float[np.ndarray, "k 2"]:
        """The places of all terms in sequence."""
        return np.concatenate([part.uv for part in self.parts])

    @cached_property
    def firsts(self) -> list[int]:
        """The index of the first place of each term."""
        return [0, *itertools.accumulate(len(part.uv) for part in self.parts[:-1])]

    def place(self, z: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        return self.origin + self.whitening @ z

    def at(self, z: Float[np.ndarray, " p"]) -> _Trial:
        """The model at z, with the positions that the terms need of it, and the residuals."""
        t = self.place(z)
        model = self.coordinates.model(t)
        position = np.split(places(model, self.uv), self.firsts[1:])
        found = [part.residual(own) for part, own in zip(self.parts, position, strict=True)]
        observed = np.concatenate(found)
        # The linear cost g·z is written as half the square of √(2K) + g·z/√(2K), less a constant; its
        # curvature vanishes for large K.
        root = np.sqrt(2 * _constant(observed))
        tilt = root + self.tilt @ z / root
        known = self.prior.root * (t - self.prior.centre)
        residuals = self.gain * np.concatenate([observed, [tilt], known])
        return _Trial(z, model, position, residuals)

    def jacobian(self, trial: _Trial) -> Float[np.ndarray, "m p"]:
        """The derivatives of the residuals by z."""
        found = [part.slopes(own) for part, own in zip(self.parts, trial.position, strict=True)]
        index = np.concatenate(
            [first + own for first, (own, _) in zip(self.firsts, found, strict=True)]
        )
        covectors = np.concatenate([part for _, part in found])
        t = self.place(trial.z)
        position = np.concatenate(trial.position)[index]
        rows = slopes_at(self.coordinates, trial.model, t, self.uv[index], covectors, position)
        tilt = self.tilt / np.sqrt(2 * _constant(rows))
        known = np.asarray(self.prior.root)[:, None] * self.whitening
        return self.gain * np.concatenate([rows @ self.whitening, tilt[None], known])


class _Trial(NamedTuple):
    """The variables z, the model there, positions on it for each term, and the residuals."""

    z: Float[np.ndarray, " p"]
    model: AbstractSurface
    position: list[np.ndarray]
    residuals: Float[np.ndarray, " m"]


def solve(
    coordinates: Coordinates,
    terms: tuple[AbstractTerm, ...],
    prior: Prior,
    t: Float[np.ndarray, " p"],
    whitening: Float[np.ndarray, "p p"],
    max_rounds: int,
    tolerance: float,
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
    first, gain, rounds, moved, shrunk = terms, _GAIN, 0, np.inf, 1.0
    while rounds < max_rounds and not moved <= tolerance:
        model = coordinates.model(t)
        renewed, parts, pulls = zip(*(x.freeze(model, len(t)) for x in terms), strict=True)
        ratios = [
            float(new.sigma) / float(old.sigma) for new, old in zip(renewed, first, strict=True)
        ]
        shrunk = min(ratios)
        scaled = shrunk * whitening
        tilt = scaled.T @ _linear(coordinates, model, t, pulls)
        held = _Round(coordinates, parts, prior, tilt, gain, t, scaled)
        z = _least(held)
        # z is zero if no step lowered the cost: then damp more, until no damping is left to try.
        stuck, nowhere = not np.any(z), gain < _GAIN / 8**3
        moved = np.inf if stuck and not nowhere else float(np.max(np.abs(z)))
        # Later steps are halved, which calms a foot point that flips between two rounds.
        t = held.place(z if rounds < _FREE_ROUNDS else 0.5 * z)
        gain = gain / 8 if stuck else min(gain * 2, _GAIN)
        terms, rounds = renewed, rounds + 1
    return State(t, terms, rounds, moved, shrunk)


def _least(held: _Round) -> Float[np.ndarray, " p"]:
    """The variables after a few Levenberg-Marquardt steps from zero."""
    here, jacobian, damping = held.at(np.zeros(len(held.origin))), None, 1.0
    for _ in range(_STEPS):
        jacobian = held.jacobian(here) if jacobian is None else jacobian
        normal = jacobian.T @ jacobian + damping * np.eye(len(here.z))
        try:
            step = -np.linalg.solve(normal, jacobian.T @ here.residuals)
        except np.linalg.LinAlgError:
            break
        trial = held.at(here.z + step)
        cost = np.sum(here.residuals**2)
        expected = np.sum((here.residuals + jacobian @ step) ** 2) - cost
        change = np.sum(trial.residuals**2) - cost
        if not change <= _TAKEN * expected:
            damping *= _MORE
            continue
        moved = trial.residuals - here.residuals
        here, jacobian = trial, None
        if _is_small(step, trial.z) and _is_small(moved, trial.residuals):
            break
        if change < _AS_EXPECTED * expected < 0:
            damping *= _LESS
    return here.z


def _is_small(change: np.ndarray, values: np.ndarray) -> bool:
    return bool(np.all(np.abs(change) < _ENOUGH * (1 + np.abs(values))))


def _linear(
    coordinates: Coordinates,
    model: AbstractSurface,
    t: Float[np.ndarray, " p"],
    pulls: tuple[Pull | None, ...],
) -> Float[np.ndarray, " p"]:
    """Derivative with respect to t of the linear part of the cost, which consists of the pulls."""
    total = np.zeros(len(t))
    for pull in pulls:
        if pull is not None:
            rows = slopes_at(coordinates, model, t, pull.uv, pull.covectors, pull.position)
            total = total + np.sum(rows, axis=0)
    return total


def _constant(rows: np.ndarray) -> float:
    return 1e3 + len(rows)
