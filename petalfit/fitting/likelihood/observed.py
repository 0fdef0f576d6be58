"""The protocol between observations and solvers: what a solver asks of an observation."""

from __future__ import annotations

import abc
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.residuals import AbstractTerm
from petalfit.surfaces import AbstractSurface


class ScoreAndInformation(NamedTuple):
    """Score and information of one observation at the end of a solve, for the coordinates t.

    Attributes:
        term: The term with converged foot points.
        information: Fisher information, shape (p, p).
        score: Expected derivative of the cost at the true parameters, shape (p,). It is not zero, which
            is the cause of a bias.
        score_covariance: Covariance of that derivative, shape (p, p); equal to the information if errors
            are independent.
        notes: Data of the observation's own, for `remaining`.
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
        weights: Weight of every datum, shape (n,).
        noise: Standard deviation of the distances, given or estimated.
        unit: "length" for the target's unit of length, or "px" for pixels.
        chi2: n log of the mean squared distance, comparable between starts.
        uv: Foot points of a cloud, shape (n, 2); None for a silhouette.
    """

    distance: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]
    noise: float
    unit: str
    chi2: float
    uv: Float[np.ndarray, "n 2"] | None = None


class AbstractObserved(abc.ABC):
    """The likelihood of one observation, or of several of one kind together, as a solver uses it."""

    @abc.abstractmethod
    def match(self, model: AbstractSurface, term: AbstractTerm | None) -> AbstractTerm:
        """The term with new correspondences; the search starts from those of `term`, if it is given."""

    @abc.abstractmethod
    def information(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> tuple[Float[np.ndarray, "p p"], float]:
        """The Fisher information of t, and the standard deviation of the noise that it assumes."""

    @abc.abstractmethod
    def misfit(self, model: AbstractSurface) -> float:
        """A mean logarithm of squared distances, by which starts are compared; small is good."""

    @abc.abstractmethod
    def score_and_information(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> ScoreAndInformation:
        """Score and information at the coordinates t where the solver stopped."""

    def remaining(
        self,
        coordinates: Coordinates,
        t: Float[np.ndarray, " p"],
        moved: Float[np.ndarray, " p"],
        found: ScoreAndInformation,
    ) -> Float[np.ndarray, " p"]:
        """The expected score, less the change of the score on the way to t; by default to first order.

        Args:
            coordinates: The free parameters.
            t: The coordinates.
            moved: Their difference from those where the solver stopped.
            found: What `score_and_information` gave there.
        """
        del coordinates, t
        return found.score - found.information @ moved

    @abc.abstractmethod
    def residuals(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm
    ) -> list[Residuals]:
        """The residuals of each observation at t."""
