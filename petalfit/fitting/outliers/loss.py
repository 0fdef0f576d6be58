"""The protocol of a loss: how a fit treats points that may not belong to the surface."""

from __future__ import annotations

import abc
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from petalfit.fitting.likelihood.mixture import Mixture
from petalfit.observations import PointCloud
from petalfit.surfaces import AbstractSurface


class AbstractBackground(abc.ABC):
    """A model of the points that do not belong to the surface."""

    @abc.abstractmethod
    def mixture(
        self,
        model: AbstractSurface,
        distance: Float[np.ndarray, " n"],
        beyond: Float[np.ndarray, " n"],
        weights: Float[np.ndarray, " n"],
        noise: float | None,
    ) -> Mixture:
        """The probability of each point to belong to the surface, given its distances from it.

        Args:
            model: The surface.
            distance: Normal distances.
            beyond: Distance of each point beyond the edge, negative inside.
            weights: The number of observations that each point counts for.
            noise: σ of the distances, or None to estimate it.
        """


class AbstractLoss(abc.ABC):
    """A loss: how a fit of a cloud treats points that may not belong to the surface.

    To add a loss, add a file to this folder and a line to `petalfit.fitting.outliers.registry`. Every
    family that has one surface can then be fitted with it, alone or jointly.

    Attributes:
        name: The value of `loss=` that selects this loss.
        meaning: Its assumption, as a sentence for help texts.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]

    @abc.abstractmethod
    def background(self, points: Float[np.ndarray, "n 3"]) -> AbstractBackground | None:
        """The model of points that do not belong to the surface; None if all points belong to it."""

    def likely(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether each point seems to belong to a surface, judged before there is any model."""
        return np.ones(len(points), bool)

    def petal_alone(self, cloud: PointCloud) -> PointCloud:
        """The cloud of a petal in an unknown place, with weight 0 for points of other sheets."""
        return cloud

    @abc.abstractmethod
    def log_likelihood(
        self,
        distance: Float[np.ndarray, " n"],
        weights: Float[np.ndarray, " n"],
        volume: float,
        area: float,
        noise: float,
    ) -> float:
        """Log likelihood of points given a fitted surface, by which families are compared.

        The density is relative to that of points spread evenly over the box around the points.

        Args:
            distance: Distances to the surface, not negative.
            weights: The number of observations that each point counts for.
            volume: The volume of the box.
            area: The area of the surface.
            noise: σ of the fit.
        """
