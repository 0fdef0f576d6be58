"""Clouds of organs of several surfaces: every part has the points that are nearest to it."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.components import AbstractAssembly
from petalfit.residuals.tangent_distance import FrozenDistance, TangentDistance
from petalfit.residuals.term import AbstractFrozen, AbstractTerm, Pull
from petalfit.surfaces import AbstractSurface


class PartsDistance(AbstractTerm):
    """The tangent distances of all parts of an assembly, each with the weights of its own points.

    Attributes:
        terms: One for every part.
        sigma: Noise, the parts' together.
    """

    terms: tuple[TangentDistance, ...]
    sigma: Float[Array, ""]

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[PartsDistance, FrozenParts, Pull]:
        assert isinstance(surface, AbstractAssembly)
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
        assert isinstance(surface, AbstractAssembly)
        return jnp.concatenate(
            [frozen.residual(surface.part(k)) for k, frozen in enumerate(self.parts)]
        )

    def slopes(self, surface: AbstractSurface) -> tuple[Float[Array, "m 2"], Float[Array, "m 3"]]:
        assert isinstance(surface, AbstractAssembly)
        places, covectors = [], []
        for k, frozen in enumerate(self.parts):
            uv, rows = frozen.slopes(surface.part(k))
            places.append(surface.in_atlas(k, uv))
            covectors.append(rows)
        return jnp.concatenate(places), jnp.concatenate(covectors)
