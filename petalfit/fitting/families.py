"""Families of petals, ranked by how well each explains a cloud for what it may choose."""

from __future__ import annotations

import math

import jax
import numpy as np

from petalfit.components import BladePetal, PeonyPetal, SplinePetal
from petalfit.fitting.patches import Patches
from petalfit.fitting.result import FitResult, Rank
from petalfit.fitting.robust import Clutter, blurred_area, mixture
from petalfit.observations import PointCloud

FAMILIES = (PeonyPetal, BladePetal, SplinePetal)


def ranked(results: list[FitResult], loss: str) -> FitResult:
    """The result with the least information criterion, and in it the ranking of all.

    Args:
        results: Fits of different families to one cloud.
        loss: "linear" or "robust", as they were fitted.
    """
    with jax.enable_x64(True):
        scored = [(information_criterion(result, loss), result) for result in results]
    scored.sort(key=lambda one: one[0])
    least, best = scored[0]
    return best.ranked(
        tuple(
            Rank(type(result.model).__name__, criterion - least, result.rms, result.freedom)
            for criterion, result in scored
        )
    )


def information_criterion(result: FitResult, loss: str) -> float:
    """Schwarz's criterion (1978): -2 log likelihood + k log n, to compare fits of one cloud.

    Points are spread evenly over the surface, so that a larger one makes each of them less likely, and
    blurred by Gaussian noise; with the loss "robust" they may be clutter instead.
    """
    part = result.agreements[0]
    assert isinstance(part.target, PointCloud)
    given = part.target.weights
    weights = np.ones(len(part.target)) if given is None else given
    used = weights > 0
    distance, weights = np.abs(part.distances[used]), weights[used]
    total = float(np.sum(weights))
    area = float(np.sum(Patches.of(result.model).area)) * float(result.pose.scale) ** 2
    volume = Clutter.around(part.target.points[used]).volume
    if loss == "robust":
        inside = np.full(len(distance), -np.inf)
        found = mixture(distance, inside, weights, volume, area, max(result.noise, 1e-300))
        log_likelihood = found.log_likelihood
    else:
        variance = max(float(np.sum(weights * distance**2)) / total, 1e-300)
        spread = blurred_area(area, math.sqrt(variance))
        log_density = math.log(volume / spread) - 0.5 * math.log(2 * math.pi * variance) - 0.5
        log_likelihood = total * log_density
    return -2 * log_likelihood + (result.freedom + 1) * math.log(total)
