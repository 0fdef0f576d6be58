"""A term against parts of a surface where no points were observed: spurs that stick out of a cloud."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.residuals.term import AbstractFrozen, AbstractTerm, Pull
from petalfit.surfaces import AbstractSurface


class Emptiness(AbstractTerm):
    """The term Σ w (d − slack)₊²/2σ², with d the distance of a surface's place to the nearest point.

    Distances from points to a surface do not penalise a spur that sticks out of the cloud. Where the
    cloud covers the surface, no place is farther from it than the slack, and this term is zero.

    Attributes:
        uv: Places of the surface, shape (n, 2).
        nearest: The point of the cloud nearest to each place, shape (n, 3).
        weights: The weight w of each place, shape (n,).
        slack: The largest distance between a covered surface and its points.
        sigma: The unit σ in which the excess is measured.
    """

    uv: Float[Array, "n 2"]
    nearest: Float[Array, "n 3"]
    weights: Float[Array, " n"]
    slack: Float[Array, ""]
    sigma: Float[Array, ""]

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[Emptiness, FrozenEmptiness, Pull]:
        offset = surface.position(self.uv[:, 0], self.uv[:, 1]) - self.nearest
        distance = jnp.linalg.norm(offset, axis=-1, keepdims=True)
        direction = offset / jnp.where(distance > 0, distance, 1.0)
        nothing = Pull(self.uv[:1], jnp.zeros((1, 3)))
        return self, FrozenEmptiness(self, direction), nothing


class FrozenEmptiness(AbstractFrozen):
    """`Emptiness` with distances along fixed directions.

    Attributes:
        term: The term.
        direction: Unit vectors from the nearest points to the places, shape (n, 3).
    """

    term: Emptiness
    direction: Float[Array, "n 3"]

    def residual(self, surface: AbstractSurface) -> Float[Array, " n"]:
        excess = self._excess(surface)
        return jnp.sqrt(self.term.weights) * jnp.maximum(excess, 0.0)

    def slopes(self, surface: AbstractSurface) -> tuple[Float[Array, "n 2"], Float[Array, "n 3"]]:
        active = jnp.where(self._excess(surface) > 0, jnp.sqrt(self.term.weights), 0.0)
        return self.term.uv, self.direction * (active / self.term.sigma)[:, None]

    def _excess(self, surface: AbstractSurface) -> Array:
        uv = self.term.uv
        offset = surface.position(uv[:, 0], uv[:, 1]) - self.term.nearest
        return (jnp.sum(offset * self.direction, axis=-1) - self.term.slack) / self.term.sigma
