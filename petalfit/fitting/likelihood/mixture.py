"""A mixture of points of a surface, blurred by noise, and clutter that is spread evenly in a box."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expit, log_ndtr

_ITERATIONS = 30
_FEWEST = 0.05  # least share of the points that belong to the surface
_SOME = 1e-3  # least share of the points that do not: a cloud is never known to be clean
_FLATTEST = 0.1  # least side of the box of the clutter, relative to the longest


def blurred_area(area: float, sigma: float) -> float:
    """The area over which the points of a surface are spread once noise has moved them.

    With the area alone, the likeliest surface would be one that shrinks to a point and takes all
    distances for noise.
    """
    return area + 2 * np.pi * sigma**2


class Mixture(NamedTuple):
    """A fitted mixture: which points of a cloud belong to the surface.

    Attributes:
        members: The probability that each point belongs to the surface, shape (n,).
        share: The share of all points that belong to the surface.
        sigma: Standard deviation of the distances of these points.
        log_likelihood: Log likelihood of the positions of all points.
        contrast: How many times as likely a point on the surface belongs to it as to the clutter.
    """

    members: Float[np.ndarray, " n"]
    share: float
    sigma: float
    log_likelihood: float
    contrast: float = np.inf

    @property
    def certainty(self) -> float:
        """The part of the information on the surface that not knowing its points leaves, from 0 to 1.

        The score of a point at z standard deviations is m z, where m is its probability to belong to the
        surface. The mean of its square over the points of the mixture is one if all of them are known.
        """
        z, step = _DEVIATIONS, _DEVIATIONS[1] - _DEVIATIONS[0]
        members = expit(np.log(max(self.contrast, 1e-300)) - 0.5 * z**2)
        return float(np.sum(members * np.exp(-0.5 * z**2) * z**2) * step / np.sqrt(2 * np.pi))


_DEVIATIONS = np.linspace(-10.0, 10.0, 401)


def mixture(
    distance: Float[np.ndarray, " n"],
    beyond: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"],
    volume: float,
    area: float,
    sigma: float,
    known: bool = False,
) -> Mixture:
    """The likeliest mixture for the distances of points to a surface, by expectation maximisation.

    Args:
        distance: Normal distances of all points.
        beyond: Distance of each point beyond the edge, negative inside.
        weights: The number of observations that each point counts for.
        volume: The volume that the clutter fills.
        area: The area of the surface.
        sigma: Standard deviation of the distances to start from.
        known: Whether `sigma` is the known noise, which is then kept.
    """
    square, total, share = distance**2, float(np.sum(weights)), 0.5
    members, likelihood = np.ones(len(distance)), -np.inf
    smallest = 1e-9 * volume / area
    for _ in range(_ITERATIONS):
        # log_ndtr: what noise leaves of an even density near an edge; see `petalfit.residuals.edge`.
        logs = np.log(volume / blurred_area(area, sigma)) - 0.5 * np.log(2 * np.pi * sigma**2)
        logs = logs - 0.5 * square / sigma**2 + log_ndtr(-beyond / sigma)
        on = share * np.exp(logs)
        either = on + 1 - share
        members, likelihood = on / either, float(np.sum(weights * np.log(either)))
        count = float(np.sum(weights * members))
        share = float(np.clip(count / total, _FEWEST, 1 - _SOME))
        if not known and count > 0:
            sigma = max(float(np.sqrt(np.sum(weights * members * square) / count)), smallest)
    contrast = (
        share / (1 - share) * volume / blurred_area(area, sigma) / (np.sqrt(2 * np.pi) * sigma)
    )
    return Mixture(members, share, sigma, likelihood, float(contrast))


def box_volume(points: Float[np.ndarray, "n 3"]) -> float:
    """The volume of the box around points, along their principal axes.

    The box is not flat: in the one around a flat sheet, clutter would be as likely as the sheet itself.
    """
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    sides = np.ptp(centred @ axes, axis=0)
    return float(np.prod(np.maximum(sides, _FLATTEST * sides.max())))
