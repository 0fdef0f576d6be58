"""Compiled rounds of the solver, between which foot points look for better places far away."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import Generic

import numpy as np
from jaxtyping import Float

from petalfit.fitting import programs
from petalfit.fitting.coordinates import Coordinates, Model
from petalfit.fitting.solve import Prior
from petalfit.residuals import AbstractTerm
from petalfit.surfaces import AbstractSurface

# In the first rounds foot points look around after every second one. Later they do not: a foot point
# that jumps to and fro must not keep the rest moving.
_LOOKING_ROUNDS = 16


class AbstractObserved(abc.ABC):
    """One observation, as the rounds need it."""

    @abc.abstractmethod
    def look(self, model: AbstractSurface, term: AbstractTerm | None) -> AbstractTerm:
        """The observation's term with foot points that looked around; `term` is the one before."""

    @abc.abstractmethod
    def information(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> tuple[Float[np.ndarray, "p p"], float]:
        """Fisher information of t, and the noise that it was computed with."""


@dataclasses.dataclass(frozen=True)
class Polished(Generic[Model]):
    """Where the solver stopped.

    Attributes:
        model: The petal.
        terms: With their foot points and noise.
        rounds: How many rounds were made.
        moved: By how much the last ones moved, in standard errors, the largest over the directions.
    """

    model: Model
    terms: tuple[AbstractTerm, ...]
    rounds: int
    moved: float

    @property
    def sigma(self) -> float:
        """Noise of the first observation, given or estimated."""
        return float(self.terms[0].sigma)


def minimise(
    coordinates: Coordinates[Model],
    observed: Sequence[AbstractObserved],
    model: Model,
    terms: Sequence[AbstractTerm | None],
    max_rounds: int,
    tolerance: float,
    prior: Prior | None = None,
    every: int | None = None,
) -> Polished[Model]:
    """From a start to the minimum of the cost.

    Args:
        coordinates: Free parameters.
        observed: Everything that was seen.
        model: The start.
        terms: One for each observation, with foot points for the start; None for no foot points.
        max_rounds: Upper bound of the rounds.
        tolerance: Stop when no parameter moves by more than this many standard errors.
        prior: What is known without the observations.
        every: Look around after so many rounds, to the end; by default after two, then never again.
    """
    t, rounds, whitening = coordinates.inverse(model), 0, None
    prior = Prior.none(len(t)) if prior is None else prior
    while True:
        terms = [x.look(model, term) for x, term in zip(observed, terms, strict=True)]
        if whitening is None:
            information = np.diag(prior.root**2) + np.eye(len(t))
            for k, (x, term) in enumerate(zip(observed, terms, strict=True)):
                part, sigma = x.information(coordinates, t, term)
                information = information + part
                terms[k] = term.with_noise(sigma)
            whitening = whiten(information)
        few = every or (2 if rounds < _LOOKING_ROUNDS else max_rounds)
        few = min(few, max_rounds - rounds)
        state = programs.solve(coordinates, tuple(terms), prior, t, whitening, few, tolerance)
        before, t, terms = t, np.asarray(state.t), list(state.terms)
        whitening = float(state.shrunk) * whitening
        moved = float(np.max(np.abs(np.linalg.solve(whitening, t - before))))
        rounds += int(state.rounds)
        model = coordinates.model(t)
        if not moved > tolerance or rounds >= max_rounds:
            return Polished(model, tuple(terms), rounds, moved)


def whiten(information: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """W with W Wᵀ the inverse of the information."""
    return np.linalg.inv(np.linalg.cholesky(information)).T
