"""Quadrature over a surface: nodes, and the area that each of them stands for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.likelihood import programs
from petalfit.residuals import blurred_width
from petalfit.surfaces import AbstractSurface

SHAPE = (25, 33)


class Quadrature(NamedTuple):
    """A quadrature with nodes that are evenly spaced in (u, v).

    Attributes:
        uv: The nodes in the domain, shape (n, 2).
        places: The nodes in space, shape (n, 3).
        area: The area around each node, shape (n_u, n_v) with n = n_u n_v.
    """

    uv: Float[np.ndarray, "n 2"]
    places: Float[np.ndarray, "n 3"]
    area: Float[np.ndarray, "25 33"]

    @classmethod
    def of(cls, model: AbstractSurface) -> Quadrature:
        """The quadrature over any surface."""
        u, v = (np.linspace(*side, n) for side, n in zip(model.domain, SHAPE, strict=True))
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.asarray(programs.places(model, uv))
        return cls(uv, places, areas_around(places.reshape(*SHAPE, 3)))

    def blurred(self, sigma: float) -> Float[np.ndarray, "25 33"]:
        """The areas over which noise σ spreads the points of each node: larger where it is narrow."""
        grid, area = self.places.reshape(*SHAPE, 3), self.area
        for axis in (0, 1):
            along = np.linalg.norm(np.gradient(grid, axis=1 - axis), axis=-1)
            width = self.area.sum(axis, keepdims=True) / along.mean(axis, keepdims=True)
            width = np.maximum(width, 1e-12 * sigma)
            area = area * np.asarray(blurred_width(width, np.asarray(sigma))[0]) / width
        return area


def areas_around(grid: Float[np.ndarray, "n_u n_v 3"]) -> Float[np.ndarray, "n_u n_v"]:
    """The area of a surface around each node of a grid on it."""
    sides = np.gradient(grid, axis=0), np.gradient(grid, axis=1)
    return np.linalg.norm(np.cross(*sides), axis=-1)
