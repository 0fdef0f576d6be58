"""The cost of a cloud of several surfaces: tangent distances to all of them, each with its own points."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import cast

import numpy as np
from jaxtyping import Float, Int

from petalfit.components import AbstractAssembly
from petalfit.residuals import (
    AbstractFrozen,
    AbstractTerm,
    FrozenDistance,
    Pull,
    TangentDistance,
)
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True, eq=False)
class PartsDistance(AbstractTerm):
    """The tangent distances of all parts of an assembly, each with the weights of its own points.

    Attributes:
        terms: One term for every part.
        sigma: Standard deviation of the noise, common to all parts.
    """

    terms: tuple[TangentDistance, ...]
    sigma: float

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[PartsDistance, FrozenParts, Pull]:
        surface = cast(AbstractAssembly, surface)
        renewed, held, pulls = [], [], []
        for k, term in enumerate(self.terms):
            new, frozen, pull = term.freeze(surface.part(k), 0)
            renewed.append(new)
            held.append(frozen)
            pulls.append(pull._replace(uv=surface.in_atlas(k, pull.uv)))
        counts = np.array([np.sum(term.data.weights) for term in renewed])
        variances = np.array([term.sigma**2 for term in renewed])
        total = max(np.sum(counts) - free, 1.0)
        sigma = float(np.sqrt(np.sum(counts * variances) / total))
        pull = Pull(*(np.concatenate(arrays) for arrays in zip(*pulls, strict=True)))
        held = [dataclasses.replace(frozen, sigma=sigma) for frozen in held]
        frozen = FrozenParts.of(surface, held)
        return PartsDistance(terms=tuple(renewed), sigma=sigma), frozen, pull


@dataclasses.dataclass(frozen=True, eq=False)
class FrozenParts(AbstractFrozen):
    """Distances to the frames at the foot points, part by part.

    Attributes:
        uv: The foot points of all parts, in the atlas of the assembly, shape (k, 2).
        parts: The distances.
    """

    uv: Float[np.ndarray, "k 2"]
    parts: tuple[FrozenDistance, ...]

    @classmethod
    def of(cls, surface: AbstractAssembly, parts: Sequence[FrozenDistance]) -> FrozenParts:
        places = [surface.in_atlas(k, frozen.uv) for k, frozen in enumerate(parts)]
        return cls(np.concatenate(places), tuple(parts))

    def residual(self, position: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " m"]:
        split = self._split(position)
        return np.concatenate([part.residual(own) for part, own, _ in split])

    def slopes(
        self, position: Float[np.ndarray, "k 3"]
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 3"]]:
        rows, covectors = [], []
        for part, own, first in self._split(position):
            index, of_part = part.slopes(own)
            rows.append(first + index)
            covectors.append(of_part)
        return np.concatenate(rows), np.concatenate(covectors)

    def _split(
        self, position: Float[np.ndarray, "k 3"]
    ) -> Iterator[tuple[FrozenDistance, Float[np.ndarray, "n 3"], int]]:
        """Every part with its positions, and the index of the first of them."""
        first = 0
        for part in self.parts:
            yield part, position[first : first + len(part.uv)], first
            first += len(part.uv)
