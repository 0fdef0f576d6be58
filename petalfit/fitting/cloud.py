"""A cloud beside a surface, as the rounds need it."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import bucket, pad_to
from petalfit.components import PeonyPetal, Posed
from petalfit.fitting import peony_start, programs
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.rounds import AbstractObserved, Account, Seen, Settled
from petalfit.observations import PointCloud
from petalfit.residuals import AbstractTerm, Data, TangentDistance, perturbation
from petalfit.surfaces import AbstractSurface

_BIAS_POINTS = 6144  # are enough to measure the bias on


def pad(points: np.ndarray, weights: np.ndarray, noise: float | None) -> Data:
    """A cloud of a bucketed size; the padding repeats the first point with weight zero."""
    size = bucket(len(points))
    return Data(
        jnp.asarray(pad_to(points, size)),
        jnp.asarray(np.concatenate([weights, np.zeros(size - len(weights))])),
        jnp.asarray(np.nan if noise is None else float(noise)),
    )


@dataclasses.dataclass(frozen=True)
class ObservedCloud(AbstractObserved):
    """A cloud, as the rounds need it.

    Attributes:
        data: The cloud.
        sample: A part of it that is large enough to measure the bias on; None for all of it.
    """

    data: Data
    sample: Data | None = None

    @classmethod
    def of(
        cls, points: np.ndarray, weights: np.ndarray, noise: float | None, order: np.ndarray
    ) -> ObservedCloud:
        """A cloud with a part of it, the first ones in `order`, that is enough to measure a bias on."""
        some = order[:_BIAS_POINTS]
        sample = None if len(order) <= _BIAS_POINTS else pad(points[some], weights[some], noise)
        return cls(pad(points, weights, noise), sample)

    @classmethod
    def used(
        cls, cloud: PointCloud, noise: float | None, rng: np.random.Generator
    ) -> ObservedCloud:
        """The points of a cloud that have a weight."""
        weights = np.ones(len(cloud)) if cloud.weights is None else cloud.weights
        some = weights > 0
        order = rng.permutation(np.count_nonzero(some))
        return cls.of(cloud.points[some], weights[some], noise, order)

    def misfit(self, model: AbstractSurface) -> float:
        """Mean logarithm of 1 + d², with d in hundredths of the cloud's extent."""
        term = self.look(model, None)
        distance = programs.distances(model, self.data.points, term.uv)
        return mean_logarithm(self.data, np.asarray(distance), np.asarray(self.data.weights))

    def at(self, uv: Float[Array, "n 2"]) -> TangentDistance:
        """Its term with these foot points and the noise still to be estimated."""
        return TangentDistance(data=self.data, uv=uv, sigma=self.data.sigma)

    def look(self, model: AbstractSurface, term: AbstractTerm | None) -> TangentDistance:
        points = self.data.points
        if term is None:
            return self.at(programs.refine(model, points, feet(model, points), 2))
        assert isinstance(term, TangentDistance)
        uv = programs.refine(model, points, term.uv, 2)
        return TangentDistance(data=self.data, uv=uv, sigma=term.sigma)

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        assert isinstance(term, TangentDistance)
        seen = programs.survey(coordinates, self.data, t, term.uv)
        return np.asarray(seen.information), float(seen.sigma)

    def account(self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm) -> Account:
        """With the score that noise and curvature cause; see `petalfit.residuals.curvature_bias`."""
        assert isinstance(term, TangentDistance)
        data, sample, model = self.data, self.sample or self.data, coordinates.model(t)
        uv = programs.refine(model, data.points, term.uv, 1)
        seen = programs.survey(coordinates, data, t, uv)
        places, position = uv, np.asarray(seen.position)
        if sample is not data:
            places = feet(model, sample.points)
            places = programs.refine(model, sample.points, places, 3)
            position = np.asarray(programs.survey(coordinates, sample, t, places).position)
        noise = float(term.sigma) * perturbation(np.asarray(places))
        weights = np.asarray(sample.weights)
        score = np.zeros(len(t))
        for moved in (position + noise, position - noise):
            around = sample._replace(points=jnp.asarray(moved))
            near = programs.refine(model, moved, places, 3, around=False)
            blurred = programs.survey(coordinates, around, t, near)
            score += np.asarray(blurred.slopes).T @ (weights * np.asarray(blurred.distance)) / 2
        share = np.sum(weights) / np.sum(np.asarray(data.weights))
        score /= share * float(seen.sigma) ** 2
        information = np.asarray(seen.information)
        term = TangentDistance(data=data, uv=uv, sigma=term.sigma)
        return Account(term, information, score, information)

    def seen(self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm) -> list[Seen]:
        assert isinstance(term, TangentDistance)
        distance = off(*self.beside(coordinates, t, term))
        weights = np.asarray(self.data.weights)
        chi2 = comparable(distance, weights)
        return [Seen(distance, weights, float(term.sigma), "length", chi2, np.asarray(term.uv))]

    def beside(
        self, coordinates: Coordinates, t: np.ndarray, term: TangentDistance
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Signed normal distances, and distances beyond the edge, negative inside; padding included."""
        seen = programs.survey(coordinates, self.data, t, term.uv)
        return np.asarray(seen.distance), np.max(np.asarray(seen.beyond), axis=-1)


def off(
    distance: Float[np.ndarray, " n"], beyond: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Signed distances to a surface that ends: along the normal, or to the edge beyond it."""
    return np.copysign(np.hypot(distance, np.maximum(beyond, 0.0)), distance)


def mean_logarithm(data: Data, distances: np.ndarray, weights: np.ndarray) -> float:
    """Of 1 + d², with distances d in hundredths of the cloud's extent; small where most are."""
    extent = 0.01 * np.linalg.norm(np.ptp(np.asarray(data.points), axis=0))
    return float(np.average(np.log1p((distances / extent) ** 2), weights=weights))


def comparable(distances: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    """A χ² that compares ends of one cloud: n log of the mean squared distance."""
    total = float(np.sum(weights))
    with np.errstate(divide="ignore"):
        return total * float(np.log(np.sum(weights * distances**2) / total))


def feet(model: AbstractSurface, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """(u, v) near the points: a start for their foot points.

    Of a petal straight below or above them: sought at the nearest place of the surface itself, many
    would end on the wrong rib.
    """
    if isinstance(model, Posed) and isinstance(model.surface, PeonyPetal):
        return feet(model.surface, jnp.asarray(model.placement.into(np.asarray(points))))
    if not isinstance(model, PeonyPetal):
        return programs.refine(model, points, programs.nearest(model, points), 6)
    return peony_start.straight_below(model, points)


def beside(
    surface: AbstractSurface, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Signed normal distances of points, distances beyond the edge, negative inside, and foot points.

    Call it inside `jax.enable_x64(True)`.
    """
    padded = jnp.asarray(pad_to(points, bucket(len(points))))
    uv = programs.refine(surface, padded, feet(surface, padded), 3)
    here = programs.frames(surface, uv)
    distance = np.asarray(here.distance(padded))
    beyond = np.max(np.asarray(here.beyond(padded)), axis=-1)
    n = len(points)
    return distance[:n], beyond[:n], np.asarray(uv)[:n]


def with_all_points(
    coordinates: Coordinates, end: Settled, number: int, cloud: PointCloud
) -> Settled:
    """An end with all points of a cloud as they came, those without weight included.

    Args:
        coordinates: The free parameters.
        end: Its observation of that number is of the points with weight, padded.
        number: Of the observation.
        cloud: The cloud.
    """
    seen = end.seen[number]
    assert seen.uv is not None
    size = len(cloud)
    given = np.ones(size) if cloud.weights is None else cloud.weights
    used = given > 0
    count = np.count_nonzero(used)
    distance, uv, weights = np.empty(size), np.empty((size, 2)), np.zeros(size)
    distance[used], uv[used] = seen.distance[:count], seen.uv[:count]
    weights[used] = seen.weights[:count]
    if count < size:
        data = pad(cloud.points[~used], np.ones(size - count), seen.noise)
        uv_rest = programs.refine(end.model, data.points, feet(end.model, data.points), 3)
        others = ObservedCloud(data)
        t = coordinates.inverse(end.model)
        (rest,) = others.seen(coordinates, t, others.at(uv_rest))
        assert rest.uv is not None
        distance[~used], uv[~used] = rest.distance[: size - count], rest.uv[: size - count]
    seen = seen._replace(distance=distance, weights=weights, uv=uv)
    parts = (*end.seen[:number], seen, *end.seen[number + 1 :])
    return dataclasses.replace(end, seen=parts)
