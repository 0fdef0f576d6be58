"""Terms of a cost: what one observation has against a surface. A joint fit adds them up."""

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
        covectors: Shape (k, 3).
    """

    uv: Float[Array, "k 2"]
    covectors: Float[Array, "k 3"]


class AbstractFrozen(eqx.Module):
    """A term with foot points held still: a residual as a function of the surface alone."""

    @abc.abstractmethod
    def residual(self, surface: AbstractSurface) -> Float[Array, " m"]:
        """In units of the noise; half the sum of its squares is the cost."""

    @abc.abstractmethod
    def slopes(self, surface: AbstractSurface) -> tuple[Float[Array, "m 2"], Float[Array, "m 3"]]:
        """Places uv and covectors w, one for each residual r: dr = w · dS(uv)."""


class AbstractTerm(eqx.Module):
    """What one observation has against a surface, with its foot points.

    Attributes:
        sigma: The noise that the last round used, in the unit of the observation.
    """

    sigma: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[AbstractTerm, AbstractFrozen, Pull | None]:
        """The term with foot points that follow the surface, what a round holds still, and a pull.

        Args:
            surface: Where the round begins.
            free: How many parameters are fitted, for the estimate of the noise.
        """

    def with_noise(self, sigma: float) -> AbstractTerm:
        """The same with another noise."""
        return eqx.tree_at(lambda term: term.sigma, self, jnp.asarray(sigma, float))
