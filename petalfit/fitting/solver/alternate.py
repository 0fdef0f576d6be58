"""Alternation of matching and solving: rounds of the compiled solver between searches for foot points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.likelihood.observed import AbstractObserved
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import show
from petalfit.fitting.solver.solve import compiled_solve
from petalfit.residuals import AbstractTerm
from petalfit.surfaces import AbstractSurface

Surface = TypeVar("Surface", bound=AbstractSurface)
# In the first rounds foot points are matched again after every second one. Later they are not: a foot
# point that jumps to and fro must not keep the rest moving.
_MATCHING_ROUNDS = 16
_WHOLE_STEPS = 6


def minimise(
    coordinates: Coordinates[Surface],
    observed: Sequence[AbstractObserved],
    model: Surface,
    terms: Sequence[AbstractTerm | None],
    max_rounds: int,
    tolerance: float,
    prior: Prior | None = None,
    every: int | None = None,
) -> Iterate[Surface]:
    """Minimises the cost from a start: rounds of the solver, between which foot points are matched again.

    Args:
        coordinates: Free parameters.
        observed: The observations.
        model: The start.
        terms: One for each observation, with foot points for the start; None for no foot points.
        max_rounds: Upper bound of the rounds.
        tolerance: Stop when no parameter moves by more than this many standard errors.
        prior: What is known without the observations.
        every: Match again after so many rounds, to the end; by default after two, and no more after
            the first rounds.
    """
    t, rounds, whitening = coordinates.inverse(model), 0, None
    prior = Prior.none(len(t)) if prior is None else prior
    while True:
        terms = [x.match(model, term) for x, term in zip(observed, terms, strict=True)]
        if whitening is None:
            information = np.diag(prior.root**2) + np.eye(len(t))
            for k, (x, term) in enumerate(zip(observed, terms, strict=True)):
                part, sigma = x.information(coordinates, t, term)
                information = information + part
                terms[k] = term.with_noise(sigma)
            whitening = whiten(information)
        few = every or (2 if rounds < _MATCHING_ROUNDS else max_rounds)
        few = min(few, max_rounds - rounds)
        state = compiled_solve(coordinates, tuple(terms), prior, t, whitening, few, tolerance)
        step, terms = np.asarray(state.t) - t, list(state.terms)
        if every is not None and rounds >= _WHOLE_STEPS:
            # Where matches jump to and fro, ever smaller steps end in the mean of the states.
            step = step / (rounds - _WHOLE_STEPS + 2)
        whitening = float(state.shrunk) * whitening
        moved = float(np.max(np.abs(np.linalg.solve(whitening, step))))
        t = t + step
        rounds += int(state.rounds)
        model = coordinates.model(t)
        show(model, terms)
        if not moved > tolerance or rounds >= max_rounds:
            return Iterate(model, tuple(terms), rounds, moved, t)


def whiten(information: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """W with W Wᵀ the inverse of the information."""
    return np.linalg.inv(np.linalg.cholesky(information)).T
