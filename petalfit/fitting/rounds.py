"""Compiled rounds of the solver, between which foot points look for better places far away."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float

from petalfit.fitting import programs
from petalfit.fitting.coordinates import Coordinates, Model, with_values
from petalfit.fitting.live import show
from petalfit.fitting.solve import Prior
from petalfit.residuals import AbstractTerm
from petalfit.surfaces import AbstractSurface

Surface = TypeVar("Surface", bound=AbstractSurface)
Progress: TypeAlias = Callable[[str], None]
# In the first rounds foot points look around after every second one. Later they do not: a foot point
# that jumps to and fro must not keep the rest moving.
_LOOKING_ROUNDS = 16
_WHOLE_STEPS = 6


class Account(NamedTuple):
    """What one observation says at the end, in the coordinates t.

    Attributes:
        term: With converged foot points.
        information: Fisher information, shape (p, p).
        score: Expected derivative of the cost at the truth, which is not zero: the cause of a bias.
        spread: Covariance of that derivative, the information if errors are independent.
        notes: What the observation keeps for `reconsider`.
    """

    term: AbstractTerm
    information: Float[np.ndarray, "p p"]
    score: Float[np.ndarray, " p"]
    spread: Float[np.ndarray, "p p"]
    notes: tuple = ()


class Seen(NamedTuple):
    """An observation beside the final surface.

    Attributes:
        distance: Signed distance of every datum, shape (n,), in `unit`.
        weights: Of every datum, shape (n,).
        noise: Standard deviation of the distances, given or estimated.
        unit: "length", the target's, or "px".
        chi2: n log of the mean squared distance, comparable between starts.
        uv: Foot points of a cloud, shape (n, 2); none for a silhouette.
    """

    distance: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]
    noise: float
    unit: str
    chi2: float
    uv: Float[np.ndarray, "n 2"] | None = None


class AbstractObserved(abc.ABC):
    """One observation, or several of a kind, as the rounds need it."""

    @abc.abstractmethod
    def look(self, model: AbstractSurface, term: AbstractTerm | None) -> AbstractTerm:
        """The term with foot points that looked around; `term` is the one before."""

    @abc.abstractmethod
    def information(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> tuple[Float[np.ndarray, "p p"], float]:
        """Fisher information of t, and the noise that it was computed with."""

    @abc.abstractmethod
    def misfit(self, model: AbstractSurface) -> float:
        """For a choice between starts: a mean logarithm of squared distances."""

    @abc.abstractmethod
    def account(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> Account:
        """What it says about t where the solver stopped."""

    def reconsider(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], account: Account
    ) -> Float[np.ndarray, " p"]:
        """What is still to be added to the score where the bias has been removed."""
        return np.zeros(len(t))

    @abc.abstractmethod
    def seen(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> list[Seen]:
        """Each observation beside the surface at t."""


@dataclasses.dataclass(frozen=True)
class Polished(Generic[Surface]):
    """Where the solver stopped.

    Attributes:
        model: The petal.
        terms: With their foot points and noise.
        rounds: How many rounds were made.
        moved: By how much the last ones moved, in standard errors, the largest over the directions.
    """

    model: Surface
    terms: tuple[AbstractTerm, ...]
    rounds: int
    moved: float


@dataclasses.dataclass(frozen=True)
class Settled(Generic[Model]):
    """One start, followed to its end.

    Attributes:
        label: What distinguishes the start.
        model: With the bias removed that the observations account for.
        information: Fisher information of the free parameters.
        spread: Covariance of the cost's derivative by them.
        seen: The observations beside it.
        rounds: How many rounds the solver made.
        moved: By how much the last ones moved, in standard errors, the largest over the directions.
        chi2: Comparable between starts of one fit.
    """

    label: str
    model: Model
    information: Float[np.ndarray, "p p"]
    spread: Float[np.ndarray, "p p"]
    seen: tuple[Seen, ...]
    rounds: int
    moved: float
    chi2: float


def minimise(
    coordinates: Coordinates[Surface],
    observed: Sequence[AbstractObserved],
    model: Surface,
    terms: Sequence[AbstractTerm | None],
    max_rounds: int,
    tolerance: float,
    prior: Prior | None = None,
    every: int | None = None,
) -> Polished[Surface]:
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
            return Polished(model, tuple(terms), rounds, moved)


def whiten(information: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """W with W Wᵀ the inverse of the information."""
    return np.linalg.inv(np.linalg.cholesky(information)).T


def glance(
    coordinates: Coordinates[Surface],
    label: str,
    observed: Sequence[AbstractObserved],
    polished: Polished[Surface],
) -> Settled[Surface]:
    """An end as the solver left it, to be compared with others: its information is not computed."""
    t = coordinates.inverse(polished.model)
    unknown = np.full((len(t), len(t)), np.nan)
    seen = [
        part
        for x, term in zip(observed, polished.terms, strict=True)
        for part in x.seen(coordinates, t, term)
    ]
    chi2 = sum(part.chi2 for part in seen)
    return Settled(
        label,
        polished.model,
        unknown,
        unknown,
        tuple(seen),
        polished.rounds,
        polished.moved,
        chi2,
    )


def finish(
    coordinates: Coordinates[Surface],
    label: str,
    observed: Sequence[AbstractObserved],
    polished: Polished[Surface],
    prior: Prior | None = None,
) -> Settled[Surface]:
    """Remove the bias, and look at the result with converged foot points."""
    t = coordinates.inverse(polished.model)
    accounts = [
        x.account(coordinates, t, term) for x, term in zip(observed, polished.terms, strict=True)
    ]
    information = np.sum([account.information for account in accounts], axis=0)
    spread = np.sum([account.spread for account in accounts], axis=0)
    score = np.sum([account.score for account in accounts], axis=0)
    scales = np.outer(coordinates.slopes(t), coordinates.slopes(t))
    root = np.zeros(len(t)) if prior is None else np.asarray(prior.root)
    t = t + _correction(information, root, score)
    pairs = zip(observed, accounts, strict=True)
    again = np.sum([x.reconsider(coordinates, t, account) for x, account in pairs], axis=0)
    t = t + _correction(information, root, again)
    values = dict(zip(coordinates.free, coordinates.values(t), strict=True))
    model = with_values(coordinates.template, values)
    # The foot points move only along the surface, which changes no distance to first order.
    terms = tuple(account.term for account in accounts)
    corrected = Polished(model, terms, polished.rounds, polished.moved)
    return dataclasses.replace(
        glance(coordinates, label, observed, corrected),
        information=information / scales,
        spread=spread / scales,
    )


def _correction(
    information: Float[np.ndarray, "p p"], root: Float[np.ndarray, " p"], score: np.ndarray
) -> Float[np.ndarray, " p"]:
    """The step that takes a score away; zero if there is none."""
    nowhere = np.zeros(len(root))
    if not (np.isfinite(information).all() and np.isfinite(score).all()):
        return nowhere
    step = np.linalg.solve(information + np.eye(len(root)) + np.diag(root**2), score)
    # A bias of more than a few standard errors is not a small correction any more.
    size = np.sqrt(step @ information @ step / len(step))
    return step * min(1.0, 3.0 / max(size, 1e-300)) if np.isfinite(size) else nowhere
