"""A mixture of points of a surface, blurred by noise, and of clutter that is spread evenly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

_ITERATIONS = 30
_FEWEST = 0.05  # of the points belong to the surface, at least
_SOME = 1e-3  # and this share does not: a cloud is never known to be clean


def blurred_area(area: float, sigma: float) -> float:
    """The area that points of a surface are spread over once noise has moved them.

    Without it a surface that shrinks to a point, with all points for noise, would be the likeliest.
    """
    return area + 2 * np.pi * sigma**2


class Mixture(NamedTuple):
    """Points of a surface among others.

    Attributes:
        members: The probability that each point belongs to the surface, shape (n,).
        share: The share of all points that do.
        sigma: Standard deviation of the distances of these.
        log_likelihood: Log likelihood of the places of all points.
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


def box_volume(points: Float[np.ndarray, "n 3"]) -> float:
    """The volume of the box around points, along their principal axes."""
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return float(np.prod(np.ptp(centred @ axes, axis=0)))
