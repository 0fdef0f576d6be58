"""The protocol of a loss: how points that may not belong to the surface are treated."""

from __future__ import annotations

import abc
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from petalfit.fitting.likelihood.mixture import Mixture
from petalfit.surfaces import AbstractSurface


class AbstractBackground(abc.ABC):
    """A model of the points that do not belong to the surface."""

    @abc.abstractmethod
    def mixture(
        self,
        model: AbstractSurface,
        distance: Float[np.ndarray, " padded"],
        beyond: Float[np.ndarray, " padded"],
        weights: Float[np.ndarray, " n"],
        noise: float | None,
    ) -> Mixture:
        """The probability of each point to belong to a surface, by where it lies beside it.

        Args:
            model: The surface.
            distance: Normal distances. They may go on after the last of the weights, with those of
                padding, and so may `beyond`.
            beyond: How far each point lies beyond the edge, negative inside.
            weights: How many observations each point counts for.
            noise: σ, or None to estimate it.
        """


class AbstractLoss(abc.ABC):
    """How a fit of a cloud treats points that may not belong to the surface.

    A loss is a file in this folder, and one line in `petalfit.fitting.outliers.registry`. Every family
    that has one surface can be fitted with it, alone or jointly.

    Attributes:
        name: The word for it in `loss=`.
        meaning: What it assumes, in a sentence for help.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]

    @abc.abstractmethod
    def background(self, points: Float[np.ndarray, "n 3"]) -> AbstractBackground | None:
        """What else may be among these points; None if all of them belong to the surface."""

    def likely(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points seem to belong to a surface, before any model is there."""
        return np.ones(len(points), bool)

    @abc.abstractmethod
    def log_likelihood(
        self,
        distance: Float[np.ndarray, " n"],
        weights: Float[np.ndarray, " n"],
        volume: float,
        area: float,
        noise: float,
    ) -> float:
        """Log likelihood of points beside a fitted surface, to compare families by.

        The density is relative to that of points which are spread evenly in the box around them.

        Args:
            distance: Distances to the surface, not negative.
            weights: How many observations each point counts for.
            volume: The volume of the box.
            area: The area of the surface.
            noise: σ of the fit.
        """
