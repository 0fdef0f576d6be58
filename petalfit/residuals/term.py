"""Terms of a cost: the misfit of one observation to a surface. A joint fit adds several terms.

Terms compute with NumPy; what they need of a surface they ask `petalfit.residuals.programs` for, because
there the compiled programs are shared.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.surfaces import AbstractSurface


class Pull(NamedTuple):
    """A cost that is linear in the surface: Σ covectors · S(uv).

    Attributes:
        uv: Places on the surface, shape (k, 2).
        covectors: A covector at each place, shape (k, 3).
        position: The positions S of the places at the beginning of a round, shape (k, 3).
    """

    uv: Float[np.ndarray, "k 2"]
    covectors: Float[np.ndarray, "k 3"]
    position: Float[np.ndarray, "k 3"]


class AbstractFrozen(abc.ABC):
    """A term whose foot points are fixed: its residuals are a function of positions on the surface alone.

    Attributes:
        uv: The places of these positions, shape (k, 2).
    """

    uv: Float[np.ndarray, "k 2"]

    @abc.abstractmethod
    def residual(self, position: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " m"]:
        """The residuals in units of the noise; half the sum of their squares is the cost."""

    @abc.abstractmethod
    def slopes(
        self, position: Float[np.ndarray, "k 3"]
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 3"]]:
        """The index i of a place and a covector w for each residual r, such that dr = w · dS(uv[i])."""


class AbstractTerm(abc.ABC):
    """The misfit of one observation to a surface, with its foot points.

    Attributes:
        sigma: The noise that the last round used, in the unit of the observation.
    """

    sigma: float

    @abc.abstractmethod
    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[AbstractTerm, AbstractFrozen, Pull | None]:
        """The term with updated foot points, its form with fixed foot points for a round, and a pull.

        Args:
            surface: The surface at the beginning of the round.
            free: The number of fitted parameters, for the estimate of the noise.
        """

    def with_noise(self, sigma: float) -> AbstractTerm:
        """The term, a dataclass, with another noise."""
        return dataclasses.replace(self, sigma=sigma)  # pyright: ignore[reportArgumentType]
