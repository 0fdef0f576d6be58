"""What a surface has against places where nothing was seen: it must not reach far beyond the points."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.residuals.term import AbstractFrozen, AbstractTerm, Pull
from petalfit.surfaces import AbstractSurface


class Emptiness(AbstractTerm):
    """Σ w (d − slack)₊²/2σ² over places of the surface, with d their distances to the nearest points.

    Distances from points to a surface do not punish a spur that sticks out of them. Where the cloud
    covers the surface no place is farther from it than the slack, and this term is silent.

    Attributes:
        uv: Places of the surface.
        nearest: The cloud's point nearest to each.
        weights: How much each counts.
        slack: How far from its points a covered surface may be.
        sigma: What the excess is measured in.
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
    """Distances along fixed directions."""

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
