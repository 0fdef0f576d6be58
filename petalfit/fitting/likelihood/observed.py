"""The protocol between observations and solvers."""

from __future__ import annotations

import abc
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.residuals import AbstractTerm
from petalfit.surfaces import AbstractSurface


class ScoreAndInformation(NamedTuple):
    """Score and information of one observation where the solver stopped, in the coordinates t.

    Attributes:
        term: The term with converged foot points.
        information: Fisher information, shape (p, p).
        score: Expected derivative of the cost at the truth, which is not zero: the cause of a bias.
        score_covariance: Covariance of that derivative; the information if errors are independent.
        notes: What the observation keeps for `second_correction`.
    """

    term: AbstractTerm
    information: Float[np.ndarray, "p p"]
    score: Float[np.ndarray, " p"]
    score_covariance: Float[np.ndarray, "p p"]
    notes: tuple = ()


class Residuals(NamedTuple):
    """The residuals of one observation.

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
    """The likelihood of one observation, or of several of a kind, as a solver needs it."""

    @abc.abstractmethod
    def match(self, model: AbstractSurface, term: AbstractTerm | None) -> AbstractTerm:
        """The term with new correspondences; the search begins at those of `term`, if that is given."""

    @abc.abstractmethod
    def information(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> tuple[Float[np.ndarray, "p p"], float]:
        """Fisher information of t, and the noise that it was computed with."""

    @abc.abstractmethod
    def misfit(self, model: AbstractSurface) -> float:
        """A mean logarithm of squared distances, by which starts are compared."""

    @abc.abstractmethod
    def score_and_information(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> ScoreAndInformation:
        """Score and information of t where the solver stopped."""

    def second_correction(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], found: ScoreAndInformation
    ) -> Float[np.ndarray, " p"]:
        """What is still to be added to the score once the bias has been removed."""
        return np.zeros(len(t))

    @abc.abstractmethod
    def residuals(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> list[Residuals]:
        """The residuals of each observation at t."""
