"""Which points belong to a surface: weights that fall with distance, and a scale that falls meanwhile.

Far from the truth a wide kernel takes in what a narrow one would throw away, so that the kernel narrows
while the surface comes nearer (graduated non-convexity; Blake and Zisserman, 1987). At the end the points
are a mixture: of the surface, blurred by the noise, and of clutter, spread evenly over the box that they
all lie in.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import log_ndtr

from petalfit.fitting.cloud import ObservedCloud, off, pad
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.kernels import geman_mcclure, spread_of
from petalfit.fitting.patches import Patches
from petalfit.fitting.rounds import Polished, minimise
from petalfit.fitting.solve import Prior
from petalfit.residuals import TangentDistance
from petalfit.surfaces import AbstractSurface

_ITERATIONS = 30
_FEWEST = 0.05  # of the points belong to the surface, at least
_UNLIKELY = 0.05  # weight of points that lie on no sheet, while a model is still far away
_WIDEST, _NARROWEST, _NARROWING = 6.0, 3.0, 0.6  # of the kernel, in spreads of the distances
_AT_ONCE, _ROUNDS = 3, 36
_TOLERANCE = 0.02  # standard errors
_UNCHANGED = 0.02  # of a probability
_SOME = 1e-3  # and this share does not: a cloud is never known to be clean


def blurred_area(area: float, sigma: float) -> float:
    """The area that points of a surface are spread over once noise has moved them.

    Without it a surface that shrinks to a point, with all points for noise, would be the likeliest.
    """
    return area + 2 * np.pi * sigma**2


class Mixture(NamedTuple):
    """Points of a surface among clutter.

    Attributes:
        members: The probability that a point belongs to the surface, shape (n,).
        share: How many do, of all.
        sigma: Standard deviation of their distances.
        log_likelihood: Of where all points lie.
    """

    members: Float[np.ndarray, " n"]
    share: float
    sigma: float
    log_likelihood: float


def mixture(
    distance: Float[np.ndarray, " n"],
    beyond: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"],
    volume: float,
    area: float,
    sigma: float,
    known: bool = False,
) -> Mixture:
    """The likeliest mixture of distances to a surface, by expectation and maximisation.

    Args:
        distance: Of all points, along the normal.
        beyond: How far each lies beyond the edge, negative inside.
        weights: How many observations each counts for.
        volume: That the clutter fills.
        area: Of the surface.
        sigma: Where to start.
        known: Whether that is the noise itself.
    """
    square, total, share = distance**2, float(np.sum(weights)), 0.5
    members, likelihood = np.ones(len(distance)), -np.inf
    smallest = 1e-9 * volume / area
    for _ in range(_ITERATIONS):
        # As blurred by noise there is as much left of an even spread; see `petalfit.residuals.edge`.
        logs = np.log(volume / blurred_area(area, sigma)) - 0.5 * np.log(2 * np.pi * sigma**2)
        logs = logs - 0.5 * square / sigma**2 + log_ndtr(-beyond / sigma)
        on = share * np.exp(logs)
        either = on + 1 - share
        members, likelihood = on / either, float(np.sum(weights * np.log(either)))
        count = float(np.sum(weights * members))
        share = float(np.clip(count / total, _FEWEST, 1 - _SOME))
        if not known and count > 0:
            sigma = max(float(np.sqrt(np.sum(weights * members * square) / count)), smallest)
    return Mixture(members, share, sigma, likelihood)


@dataclasses.dataclass(frozen=True)
class Clutter:
    """Points that belong to no surface, spread evenly.

    Attributes:
        volume: Of the box around all points, along their principal axes.
    """

    volume: float

    @classmethod
    def around(cls, points: Float[np.ndarray, "n 3"]) -> Clutter:
        """In the box that the points lie in."""
        centred = points - points.mean(axis=0)
        _, axes = np.linalg.eigh(centred.T @ centred)
        return cls(float(np.prod(np.ptp(centred @ axes, axis=0))))

    def mixture(
        self,
        model: AbstractSurface,
        distance: Float[np.ndarray, " padded"],
        beyond: Float[np.ndarray, " padded"],
        weights: Float[np.ndarray, " n"],
        noise: float | None,
    ) -> Mixture:
        """Which points belong to a surface, by where they lie beside it; see `mixture`.

        Distances may go on after the last of the weights, those of padding.
        """
        distance, beyond = np.abs(distance[: len(weights)]), beyond[: len(weights)]
        start = spread_of(distance) if noise is None else noise
        area = float(np.sum(Patches.of(model).area))
        return mixture(distance, beyond, weights, self.volume, area, start, noise is not None)


class Cleared(NamedTuple):
    """A surface that was brought to its own points.

    Attributes:
        polished: Where the solver stopped.
        cloud: With the weights of its last round.
        mixture: Of the points at its end.
    """

    polished: Polished
    cloud: ObservedCloud
    mixture: Mixture


def approach(
    coordinates: Coordinates,
    clutter: Clutter,
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    likely: Bool[np.ndarray, " n"],
) -> Cleared:
    """From a rough start to the surface, with a kernel that narrows.

    Args:
        coordinates: Free parameters.
        clutter: What else is there.
        model: The start.
        points: All of them.
        weights: How many observations each counts for.
        likely: Which of them seem to belong to a surface; the others count for little.
    """
    base = weights * np.where(likely, 1.0, _UNLIKELY)
    cloud = ObservedCloud(pad(points, base, None))
    term, scale, n = cloud.look(model, None), np.inf, len(points)
    while True:
        distance = np.abs(off(*cloud.beside(coordinates, coordinates.inverse(model), term))[:n])
        narrowest = _NARROWEST * spread_of(distance[likely])
        scale = min(_WIDEST / _NARROWEST * narrowest, scale)
        kept = base * geman_mcclure(distance, max(scale, narrowest))
        polished, seen, term = _followed(coordinates, model, points, kept, None, term, 2, 0.3)
        model, term = polished.model, cloud.look(polished.model, term)
        if scale <= narrowest:
            beside = cloud.beside(coordinates, coordinates.inverse(model), term)
            return Cleared(polished, seen, clutter.mixture(model, *beside, weights, None))
        scale *= _NARROWING


def clear(
    coordinates: Coordinates,
    clutter: Clutter,
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    noise: float | None,
    prior: Prior | None,
) -> Cleared:
    """From near the surface to the likeliest one, and the probabilities that points belong to it.

    Args:
        coordinates: Free parameters.
        clutter: What else is there.
        model: The start.
        points: All of them.
        weights: How many observations each counts for.
        noise: Known, or None.
        prior: What is known besides.
    """
    cloud = ObservedCloud(pad(points, weights, noise))
    term, rounds, members = cloud.look(model, None), 0, None
    while True:
        beside = cloud.beside(coordinates, coordinates.inverse(model), term)
        found = clutter.mixture(model, *beside, weights, noise)
        kept = weights * found.members
        polished, seen, term = _followed(
            coordinates, model, points, kept, noise, term, _AT_ONCE, _TOLERANCE, prior
        )
        rounds, model = rounds + polished.rounds, polished.model
        changed = 1.0 if members is None else float(np.max(np.abs(found.members - members)))
        members = found.members
        settled = polished.moved <= _TOLERANCE and changed < _UNCHANGED
        if settled or rounds >= _ROUNDS:
            return Cleared(dataclasses.replace(polished, rounds=rounds), seen, found)


def _followed(
    coordinates: Coordinates,
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    noise: float | None,
    term: TangentDistance,
    rounds: int,
    tolerance: float,
    prior: Prior | None = None,
) -> tuple[Polished, ObservedCloud, TangentDistance]:
    """A few rounds on points with these weights: where they end, the cloud, and its term there."""
    seen = ObservedCloud(pad(points, weights, noise))
    polished = minimise(coordinates, [seen], model, [seen.at(term.uv)], rounds, tolerance, prior)
    (end,) = polished.terms
    assert isinstance(end, TangentDistance)
    return polished, seen, end
