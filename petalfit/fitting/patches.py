"""A surface cut into patches: their places, and the area that each stands for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting import programs
from petalfit.residuals import blurred_width
from petalfit.surfaces import AbstractSurface, Domain

SHAPE = (25, 33)


class Patches(NamedTuple):
    """Evenly spaced in (u, v).

    Attributes:
        uv: Their middles.
        places: In space.
        area: Around each.
    """

    uv: Float[np.ndarray, "n 2"]
    places: Float[np.ndarray, "n 3"]
    area: Float[np.ndarray, "25 33"]

    @classmethod
    def of(cls, model: AbstractSurface) -> Patches:
        """Of any surface."""
        u, v = (np.linspace(*side, n) for side, n in zip(model.domain, SHAPE, strict=True))
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.asarray(programs.places(model, uv))
        return cls(uv, places, areas_around(places.reshape(*SHAPE, 3)))

    def blurred(self, sigma: float) -> Float[np.ndarray, "25 33"]:
        """The areas over which noise σ spreads what lies there: larger where the surface is narrow."""
        grid, area = self.places.reshape(*SHAPE, 3), self.area
        for axis in (0, 1):
            along = np.linalg.norm(np.gradient(grid, axis=1 - axis), axis=-1)
            width = self.area.sum(axis, keepdims=True) / along.mean(axis, keepdims=True)
            width = np.maximum(width, 1e-12 * sigma)
            area = area * np.asarray(blurred_width(width, np.asarray(sigma))[0]) / width
        return area


def cells(
    domain: Domain, uv: Float[np.ndarray, "n 2"], side: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """In which of side x side cells of a domain places are, by u and by v."""
    low, high = np.array(domain).T
    across, along = np.clip((side * (uv - low) / (high - low)).astype(int), 0, side - 1).T
    return across, along


def areas_around(grid: Float[np.ndarray, "n_u n_v 3"]) -> Float[np.ndarray, "n_u n_v"]:
    """The area of a sheet around each of its nodes."""
    sides = np.gradient(grid, axis=0), np.gradient(grid, axis=1)
    return np.linalg.norm(np.cross(*sides), axis=-1)
