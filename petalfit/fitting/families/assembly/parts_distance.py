"""The cost of a cloud of several surfaces: tangent distances to all of them, each with its own points."""

from __future__ import annotations

from typing import cast

import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.components import AbstractAssembly
from petalfit.residuals import (
    AbstractFrozen,
    AbstractTerm,
    FrozenDistance,
    Pull,
    TangentDistance,
)
from petalfit.surfaces import AbstractSurface


class PartsDistance(AbstractTerm):
    """The tangent distances of all parts of an assembly, each with the weights of its own points.

    Attributes:
        terms: One term for every part.
        sigma: Standard deviation of the noise, common to all parts.
    """

    terms: tuple[TangentDistance, ...]
    sigma: Float[Array, ""]

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[PartsDistance, FrozenParts, Pull]:
        surface = cast(AbstractAssembly, surface)
        renewed, held, pulls = [], [], []
        for k, term in enumerate(self.terms):
            new, frozen, pull = term.freeze(surface.part(k), 0)
            renewed.append(new)
            held.append(frozen)
            pulls.append(Pull(surface.in_atlas(k, pull.uv), pull.covectors))
        counts = jnp.stack([jnp.sum(term.data.weights) for term in renewed])
        variances = jnp.stack([term.sigma**2 for term in renewed])
        total = jnp.maximum(jnp.sum(counts) - free, 1.0)
        sigma = jnp.sqrt(jnp.sum(counts * variances) / total)
        pull = Pull(*(jnp.concatenate(arrays) for arrays in zip(*pulls, strict=True)))
        held = [with_sigma(frozen, sigma) for frozen in held]
        return PartsDistance(terms=tuple(renewed), sigma=sigma), FrozenParts(tuple(held)), pull


def with_sigma(frozen: FrozenDistance, sigma: Float[Array, ""]) -> FrozenDistance:
    """The same distances in units of another noise."""
    return FrozenDistance(frozen.data, frozen.uv, sigma, frozen.frame, frozen.near)


class FrozenParts(AbstractFrozen):
    """Distances to the frames at the foot points, part by part."""

    parts: tuple[FrozenDistance, ...]

    def residual(self, surface: AbstractSurface) -> Float[Array, " m"]:
        surface = cast(AbstractAssembly, surface)
        return jnp.concatenate(
            [frozen.residual(surface.part(k)) for k, frozen in enumerate(self.parts)]
        )

    def slopes(self, surface: AbstractSurface) -> tuple[Float[Array, "m 2"], Float[Array, "m 3"]]:
        surface = cast(AbstractAssembly, surface)
        places, covectors = [], []
        for k, frozen in enumerate(self.parts):
            uv, rows = frozen.slopes(surface.part(k))
            places.append(surface.in_atlas(k, uv))
            covectors.append(rows)
        return jnp.concatenate(places), jnp.concatenate(covectors)
