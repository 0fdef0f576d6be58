"""Least squares: every point belongs to the surface, and has Gaussian noise."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from petalfit.fitting.likelihood.mixture import blurred_area
from petalfit.fitting.outliers.loss import AbstractBackground, AbstractLoss


class Linear(AbstractLoss):
    """The loss of least squares, which is right for noise without gross outliers."""

    name: ClassVar[str] = "linear"
    meaning: ClassVar[str] = "all points belong to the petal"

    def background(self, points: np.ndarray) -> AbstractBackground | None:
        return None

    def log_likelihood(
        self,
        distance: np.ndarray,
        weights: np.ndarray,
        volume: float,
        area: float,
        noise: float,
    ) -> float:
        del noise  # the distances' own variance is the likeliest
        total = float(np.sum(weights))
        variance = max(float(np.sum(weights * distance**2)) / total, 1e-300)
        spread = blurred_area(area, math.sqrt(variance))
        log_density = math.log(volume / spread) - 0.5 * math.log(2 * math.pi * variance) - 0.5
        return total * log_density
