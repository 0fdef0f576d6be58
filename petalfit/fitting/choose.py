"""The choice of a family: the one that explains a cloud best, given its number of parameters."""

from __future__ import annotations

import jax
import numpy as np

from petalfit.fitting.likelihood.mixture import box_volume
from petalfit.fitting.likelihood.quadrature import Quadrature
from petalfit.fitting.outliers.loss import AbstractLoss
from petalfit.fitting.result import FitResult
from petalfit.observations import PointCloud
from petalfit.results import Rank


def ranked(results: list[FitResult], loss: AbstractLoss) -> FitResult:
    """The result with the least information criterion, with the ranking of all results in it.

    Args:
        results: Fits of different families to one cloud.
        loss: The loss with which they were fitted.
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


def information_criterion(result: FitResult, loss: AbstractLoss) -> float:
    """Schwarz's criterion (1978), −2 log likelihood + k log n, by which fits of one cloud are compared.

    The likelihood assumes points that are spread evenly over the surface, so that a larger surface makes
    each of them less likely, and that are blurred by Gaussian noise. The loss may allow for outliers.
    """
    part = result.agreements[0]
    assert isinstance(part.target, PointCloud)
    used = part.target.mass > 0
    distance, weights = np.abs(part.distances[used]), part.target.mass[used]
    area = float(np.sum(Quadrature.of(result.model).area)) * float(result.pose.scale) ** 2
    volume = box_volume(part.target.points[used])
    log_likelihood = loss.log_likelihood(distance, weights, volume, area, result.noise)
    return -2 * log_likelihood + (result.freedom + 1) * np.log(float(np.sum(weights)))
