"""The likelihood of a cloud: tangent distances at its foot points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.foot_points import (
    beside,
    distances,
    guess_foot_points,
    nearer_foot_points,
    signed_distance,
    whole_distance,
)
from petalfit.fitting.likelihood.linearise import linearise, tangents_at
from petalfit.fitting.likelihood.mixture import Mixture
from petalfit.fitting.likelihood.observed import (
    AbstractObserved,
    Residuals,
    ScoreAndInformation,
)
from petalfit.fitting.likelihood.scales import spread_of
from petalfit.observations import PointCloud
from petalfit.residuals import (
    AbstractTerm,
    Data,
    TangentDistance,
    frames,
    perturbation,
    places,
    refine_foot_points,
    slide_foot_points,
)
from petalfit.surfaces import AbstractSurface

BIAS_POINTS = 6144  # this many points are enough to measure the bias
_ROUNDING = 1e-12  # smaller distances, relative to the largest coordinate, are rounding errors
_FAR = 6.0  # typical distances, beyond which a foot point may be on the wrong fold


@dataclasses.dataclass(frozen=True)
class ObservedCloud(AbstractObserved):
    """The likelihood of a cloud, as a solver uses it.

    Attributes:
        data: The cloud.
        sample: A part of the cloud that is large enough to measure the bias on; None for all of it.
        weigh: Finds the points that belong to a model, as the mixture of a background does, every time
            that points are matched; None if all of them do.
    """

    data: Data
    sample: Data | None = None
    weigh: Callable[..., Mixture] | None = None

    @classmethod
    def of(
        cls, points: np.ndarray, weights: np.ndarray, noise: float | None, order: np.ndarray
    ) -> ObservedCloud:
        """The cloud of points; the first ones in `order` are the sample that the bias is measured on."""
        some = order[:BIAS_POINTS]
        sample = None if len(order) <= BIAS_POINTS else Data.of(points[some], weights[some], noise)
        return cls(Data.of(points, weights, noise), sample)

    @classmethod
    def used(
        cls,
        cloud: PointCloud,
        noise: float | None,
        rng: np.random.Generator,
        weigh: Callable[..., Mixture] | None = None,
    ) -> ObservedCloud:
        """The cloud of those points that have a weight."""
        some = cloud.mass > 0
        order = rng.permutation(np.count_nonzero(some))
        found = cls.of(cloud.points[some], cloud.mass[some], noise, order)
        return dataclasses.replace(found, weigh=weigh)

    def misfit(self, model: AbstractSurface) -> float:
        """Mean logarithm of 1 + d², with d in hundredths of the cloud's extent."""
        term = self.match(model, None)
        apart = distances(model, self.data.points, term.uv)
        return mean_logarithm(self.data, apart, self.data.weights)

    def at(self, uv: Float[np.ndarray, "n 2"]) -> TangentDistance:
        """The term of the cloud with these foot points, and noise as given or still to be estimated."""
        return TangentDistance(data=self.data, uv=uv, sigma=self.data.sigma)

    def match(self, model: AbstractSurface, term: AbstractTerm | None) -> TangentDistance:
        points = self.data.points
        if term is None:
            uv = refine_foot_points(model, points, guess_foot_points(model, points), 2)
            return self._weighed(model, self.at(uv))
        assert isinstance(term, TangentDistance)
        uv = refine_foot_points(model, points, term.uv, 2)
        return self._weighed(model, dataclasses.replace(self.at(uv), sigma=term.sigma))

    def _weighed(self, model: AbstractSurface, term: TangentDistance) -> TangentDistance:
        """The term whose points count by the probability that they belong to the model."""
        if self.weigh is None:
            return term
        weights = self.data.weights * self._mixture(model, term).members
        return dataclasses.replace(term, data=self.data._replace(weights=weights))

    def _mixture(self, model: AbstractSurface, term: TangentDistance) -> Mixture:
        assert self.weigh is not None
        given = float(self.data.sigma)
        noise = None if np.isnan(given) else given
        return self.weigh(model, *self.apart(model, term), self.data.weights, noise)

    def apart(
        self, model: AbstractSurface, term: TangentDistance
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """How far points are from the surface and beyond its edge, negative inside.

        See `whole_distance`.
        """
        here, points = frames(model, term.uv), self.data.points
        distance, beyond = here.distance(points), here.beyond(points)
        return whole_distance(points - here.position, distance, beyond), np.max(beyond, axis=-1)

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        assert isinstance(term, TangentDistance)
        seen = linearise(coordinates, term.data, t, term.uv)
        return seen.information, seen.sigma

    def score_and_information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> ScoreAndInformation:
        """See `AbstractObserved`; noise and curvature cause the score (`residuals.curvature_bias`)."""
        assert isinstance(term, TangentDistance)
        data, model = term.data, coordinates.model(t)
        sample = data if self.sample is None or self.weigh is not None else self.sample
        uv = refine_foot_points(model, data.points, term.uv, 1)
        seen = linearise(coordinates, data, t, uv)
        clean, position = uv, seen.position
        if sample is not data:
            clean = guess_foot_points(model, sample.points)
            clean = refine_foot_points(model, sample.points, clean, 3)
            position = places(model, clean)
        noise = float(term.sigma) * perturbation(clean)
        score = np.zeros(len(t))
        for moved in (position + noise, position - noise):
            near, _, _ = slide_foot_points(model, moved, clean, 3)
            here, slopes = tangents_at(coordinates, t, near)
            score += slopes.T @ (sample.weights * here.distance(moved)) / 2
        share = np.sum(sample.weights) / np.sum(data.weights)
        score /= share * seen.sigma**2
        term = dataclasses.replace(term, uv=uv)
        return ScoreAndInformation(term, seen.information, score, seen.information)

    def residuals(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> list[Residuals]:
        assert isinstance(term, TangentDistance)
        model, weights = coordinates.model(t), term.data.weights
        distance = signed_distance(*beside(model, self.data.points, term.uv))
        chi2 = comparable(distance, weights)
        if self.weigh is not None:
            chi2 = -2 * self._mixture(model, term).log_likelihood
        return [Residuals(distance, weights, float(term.sigma), "length", chi2, term.uv)]

    def rematched(self, model: AbstractSurface, term: TangentDistance) -> TangentDistance | None:
        """The term with nearer foot points for some of the points far beyond the typical distance.

        None if there are no such points, or no nearer places for them.
        """
        points, used = self.data.points, self.data.weights > 0
        distance = distances(model, points, term.uv)
        rounding = _ROUNDING * float(np.abs(points).max())
        typical = max(spread_of(distance[used]), rounding)
        far = np.flatnonzero(used & (distance > _FAR * typical))
        if not len(far):
            return None
        uv = nearer_foot_points(model, points, term.uv, far)
        return None if uv is None else self.at(uv)


def mean_logarithm(data: Data, distances: np.ndarray, weights: np.ndarray) -> float:
    """Mean logarithm of 1 + d², with d in hundredths of the cloud's extent; small if most d are small."""
    extent = 0.01 * np.linalg.norm(np.ptp(data.points, axis=0))
    return float(np.average(np.log1p((distances / extent) ** 2), weights=weights))


def comparable(distances: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    """A χ² by which ends of one cloud are compared: n log of the mean squared distance."""
    total = float(np.sum(weights))
    with np.errstate(divide="ignore"):
        return total * float(np.log(np.sum(weights * distances**2) / total))
