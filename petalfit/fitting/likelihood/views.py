"""The likelihood of silhouettes: contour distances at matched places, and the errors of pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.linearise import contour_slopes
from petalfit.fitting.likelihood.matching import View, rows, term_of_rows
from petalfit.fitting.likelihood.observed import (
    AbstractObserved,
    Residuals,
    ScoreAndInformation,
)
from petalfit.fitting.likelihood.pixels import pixel_errors, repeated
from petalfit.observations import Contour
from petalfit.residuals import AbstractTerm, ContourDistance
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True)
class ObservedViews(AbstractObserved):
    """The likelihood of all silhouettes of a fit in one term, so that one program serves any number."""

    views: tuple[View, ...]

    @classmethod
    def of(cls, contours: Sequence[Contour]) -> ObservedViews:
        return cls(tuple(View(contour, contour.size) for contour in contours))

    def match(self, model: AbstractSurface, term: AbstractTerm | None) -> ContourDistance:
        parts = []
        for view in self.views:
            match = view.match(model)
            noise = view.noise(match)
            # Both directions carry the same information: together they count once.
            share = view.cauchy_weight(match, noise) / (2 * view.correlated(match, noise))
            parts.append(rows(view.contour, match, np.sqrt(match.length * share) / noise))
        return term_of_rows(parts)

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        assert isinstance(term, ContourDistance)
        slopes = contour_slopes(coordinates, t, term)
        return slopes.T @ slopes, 1.0

    def score_and_information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> ScoreAndInformation:
        """See `AbstractObserved`; the score is the one that pixels cause (`likelihood.pixels`)."""
        term = self.match(coordinates.model(t), None)
        errors = tuple(pixel_errors(coordinates, t, view) for view in self.views)
        information, _ = self.information(coordinates, t, term)
        score = np.sum([error.score for error in errors], axis=0)
        covariance = np.sum([error.score_covariance for error in errors], axis=0)
        return ScoreAndInformation(term, information, score, covariance, errors)

    def remaining(
        self,
        coordinates: Coordinates,
        t: np.ndarray,
        moved: np.ndarray,
        found: ScoreAndInformation,
    ) -> np.ndarray:
        """See `AbstractObserved`; the expected score has the pattern of the target's own pixel errors."""
        del moved
        pairs = zip(self.views, found.notes, strict=True)
        return np.sum([repeated(coordinates, t, *pair) for pair in pairs], axis=0)

    def residuals(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> list[Residuals]:
        model, found = coordinates.model(t), []
        for view in self.views:
            match = view.match(model)
            forward = match.forward
            distance, weights = -match.distance[forward], match.length[forward]
            chi2 = view.chi2(match)
            found.append(Residuals(distance, weights, view.noise(match), "px", chi2))
        return found

    def misfit(self, model: AbstractSurface) -> float:
        """Mean over the views and both directions of log(1 + (d/kernel)²)."""
        matches = [view.match(model) for view in self.views]
        scores = [
            np.average(np.log1p((match.distance / view.kernel) ** 2), weights=match.length)
            for view, match in zip(self.views, matches, strict=True)
        ]
        return float(np.mean(scores))
