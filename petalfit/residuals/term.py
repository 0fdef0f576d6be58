"""Terms of a cost: the misfit of one observation to a surface. A joint fit adds several terms."""

from __future__ import annotations

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.surfaces import AbstractSurface


class Pull(NamedTuple):
    """A cost that is linear in the surface: Σ covectors · S(uv).

    Attributes:
        uv: Places on the surface, shape (k, 2).
        covectors: A covector at each place, shape (k, 3).
    """

    uv: Float[Array, "k 2"]
    covectors: Float[Array, "k 3"]


class AbstractFrozen(eqx.Module):
    """A term whose foot points are fixed: its residuals are a function of the surface alone."""

    @abc.abstractmethod
    def residual(self, surface: AbstractSurface) -> Float[Array, " m"]:
        """The residuals in units of the noise; half the sum of their squares is the cost."""

    @abc.abstractmethod
    def slopes(self, surface: AbstractSurface) -> tuple[Float[Array, "m 2"], Float[Array, "m 3"]]:
        """A place uv and a covector w for each residual r, such that dr = w · dS(uv)."""


class AbstractTerm(eqx.Module):
    """The misfit of one observation to a surface, with its foot points.

    Attributes:
        sigma: The noise that the last round used, in the unit of the observation.
    """

    sigma: eqx.AbstractVar[Float[Array, ""]]

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
        """The term with another noise."""
        return eqx.tree_at(lambda term: term.sigma, self, jnp.asarray(sigma, float))
