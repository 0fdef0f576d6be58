"""Alternation of matching and solving: a search for foot points, then rounds of the solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.likelihood.observed import AbstractObserved
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import show
from petalfit.fitting.solver.solve import solve
from petalfit.residuals import AbstractTerm
from petalfit.surfaces import AbstractSurface

Surface = TypeVar("Surface", bound=AbstractSurface)
# In the first rounds foot points are matched again after every second round. Later they are not: a foot
# point that jumps to and fro must not keep the parameters moving.
_MATCHING_ROUNDS = 16
_WHOLE_STEPS = 6  # rounds, after which steps become shorter if `every` is given


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
    """Minimises the cost from a start, in rounds of the solver with foot points matched in between.

    Args:
        coordinates: The free parameters.
        observed: The observations.
        model: The start.
        terms: One term for each observation, with foot points at the start, or None to search for them.
        max_rounds: Upper bound of the rounds.
        tolerance: Stop when the step is at most this many standard errors in every direction.
        prior: The prior on the coordinates; None for no prior.
        every: Match foot points again after this many rounds, until the end. By default they are matched
            after every second round, and no more after the first 16 rounds.

    Returns:
        The last iterate.
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
        state = solve(coordinates, tuple(terms), prior, t, whitening, few, tolerance)
        step, terms = state.t - t, list(state.terms)
        if every is not None and rounds >= _WHOLE_STEPS:
            # If matches jump to and fro, ever shorter steps converge to the mean of the states.
            step = step / (rounds - _WHOLE_STEPS + 2)
        whitening = state.shrunk * whitening
        rounds += state.rounds
        if not np.isfinite(step).all():
            # Nothing but overflow lies ahead: the descent ends where it stands, and has not settled.
            return Iterate(model, tuple(terms), rounds, np.inf, t)
        moved = float(np.max(np.abs(np.linalg.solve(whitening, step))))
        t = t + step
        model = coordinates.model(t)
        show(model, terms)
        if not moved > tolerance or rounds >= max_rounds:
            return Iterate(model, tuple(terms), rounds, moved, t)


def whiten(information: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """The whitening matrix W, for which W Wᵀ is the inverse of the information."""
    try:
        return np.linalg.inv(np.linalg.cholesky(information)).T
    except np.linalg.LinAlgError:
        # A hopeless start makes some directions count so much that rounding loses all others.
        values, vectors = np.linalg.eigh(information)
        return vectors / np.sqrt(np.maximum(values, np.finfo(float).eps * values[-1]))
