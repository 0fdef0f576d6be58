"""The likelihood of a cloud of several surfaces, whose points are first assigned to the parts."""

from __future__ import annotations

import dataclasses
from typing import cast

import numpy as np
from jaxtyping import Float

from petalfit.components import AbstractAssembly
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.families.assembly.parts_distance import PartsDistance
from petalfit.fitting.likelihood.cloud import ObservedCloud, comparable, mean_logarithm
from petalfit.fitting.likelihood.foot_points import distances
from petalfit.fitting.likelihood.linearise import linearise
from petalfit.fitting.likelihood.observed import (
    AbstractObserved,
    Residuals,
    ScoreAndInformation,
)
from petalfit.residuals import (
    AbstractTerm,
    Data,
    TangentDistance,
    nearest_nodes,
    refine_foot_points,
)
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True)
class ObservedParts(AbstractObserved):
    """The likelihood of a cloud of an assembly, as a solver uses it.

    Attributes:
        data: The cloud.
    """

    data: Data

    @classmethod
    def of(cls, points: np.ndarray, weights: np.ndarray, noise: float | None) -> ObservedParts:
        return cls(Data.of(points, weights, noise))

    def match(self, model: AbstractSurface, term: AbstractTerm | None) -> PartsDistance:
        """The term with foot points on every part, and each point shared among the parts near it."""
        places, gaps = self._reach(model, term)
        sigma = self.data.sigma if term is None else term.sigma
        terms = tuple(
            TangentDistance(
                data=self.data._replace(weights=self.data.weights * share),
                uv=uv,
                sigma=self.data.sigma,
            )
            for share, uv in zip(_shares(gaps, float(sigma)), places, strict=True)
        )
        return PartsDistance(terms=terms, sigma=sigma)

    def _reach(
        self, model: AbstractSurface, term: AbstractTerm | None
    ) -> tuple[list[np.ndarray], Float[np.ndarray, "k n"]]:
        """Foot points of all points on every part, and the distances to them."""
        points, places, gaps = self.data.points, [], []
        for k, (pose, surface) in enumerate(cast(AbstractAssembly, model).parts().values()):
            # Points are taken to the part's own frame, so that parts of one kind share their programs.
            own = pose.into(points)
            known = isinstance(term, PartsDistance)
            start = term.terms[k].uv if known else nearest_nodes(surface, own)
            uv = refine_foot_points(surface, own, start, 2 if known else 6)
            places.append(uv)
            gaps.append(distances(surface, own, uv) * float(pose.scale))
        return places, np.stack(gaps)

    def misfit(self, model: AbstractSurface) -> float:
        _, gaps = self._reach(model, None)
        shares = _shares(gaps, float(self.data.sigma)) * self.data.weights
        return mean_logarithm(self.data, gaps, shares)

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        assert isinstance(term, PartsDistance)
        surveys = [
            linearise(_within(coordinates, k), part.data, t, part.uv)
            for k, part in enumerate(term.terms)
        ]
        counts = np.array([float(np.sum(part.data.weights)) for part in term.terms])
        sigmas = np.array([seen.sigma for seen in surveys])
        sigma = float(np.sqrt(np.sum(counts * sigmas**2) / np.sum(counts)))
        information = np.sum(
            [seen.information * (own / sigma) ** 2
             for seen, own in zip(surveys, sigmas, strict=True)], axis=0)  # fmt: skip
        return information, sigma

    def score_and_information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> ScoreAndInformation:
        assert isinstance(term, PartsDistance)
        noise = term.sigma
        found = []
        for k, part in enumerate(term.terms):
            data = part.data._replace(sigma=noise)
            if float(np.sum(data.weights)) == 0:
                continue
            one = TangentDistance(data=data, uv=part.uv, sigma=noise)
            found.append(ObservedCloud(data).score_and_information(_within(coordinates, k), t, one))
        information = np.sum([part.information for part in found], axis=0)
        score = np.sum([part.score for part in found], axis=0)
        return ScoreAndInformation(term, information, score, information)

    def residuals(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> list[Residuals]:
        assert isinstance(term, PartsDistance)
        parts = [
            ObservedCloud(part.data).residuals(_within(coordinates, k), t, part)[0]
            for k, part in enumerate(term.terms)
        ]
        owner = np.argmin([np.abs(part.distance) for part in parts], axis=0)
        distance = np.choose(owner, [part.distance for part in parts])
        weights = self.data.weights
        chi2 = comparable(distance, weights)
        return [Residuals(distance, weights, term.sigma, "length", chi2)]


def _shares(gaps: Float[np.ndarray, "k n"], sigma: float) -> Float[np.ndarray, "k n"]:
    """The probability of each point to belong to each part, if all parts are covered equally densely.

    The nearest part is not always the right one where parts meet: taking it would pull both parts there.
    """
    if not np.isfinite(sigma):
        return (gaps == gaps.min(axis=0)).astype(float)
    likely = np.exp(-0.5 * (gaps**2 - gaps.min(axis=0) ** 2) / sigma**2)
    return likely / likely.sum(axis=0)


def _within(coordinates: Coordinates, number: int) -> Coordinates:
    """The same coordinates for one part of the assembly alone."""
    return dataclasses.replace(coordinates, template=coordinates.template.part(number))
