"""Quadrature over a surface: nodes, and the area that each of them stands for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.residuals import places
from petalfit.surfaces import AbstractSurface

SHAPE = (25, 33)


class Quadrature(NamedTuple):
    """A quadrature with nodes that are evenly spaced in (u, v).

    Attributes:
        places: The nodes in space, shape (n, 3).
        area: The area around each node, shape (n_u, n_v) with n = n_u n_v.
    """

    places: Float[np.ndarray, "n 3"]
    area: Float[np.ndarray, "25 33"]

    @classmethod
    def of(cls, model: AbstractSurface) -> Quadrature:
        """The quadrature over any surface."""
        u, v = (np.linspace(*side, n) for side, n in zip(model.domain, SHAPE, strict=True))
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        nodes = places(model, uv)
        return cls(nodes, areas_around(nodes.reshape(*SHAPE, 3)))


def around(grid: np.ndarray) -> np.ndarray:
    """The values at the nodes along the four sides of a grid, once around."""
    return np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]])


def areas_around(grid: Float[np.ndarray, "n_u n_v 3"]) -> Float[np.ndarray, "n_u n_v"]:
    """The area of a surface around each node of a grid on it."""
    return np.linalg.norm(normals_around(grid), axis=-1)


def normals_around(grid: Float[np.ndarray, "n_u n_v 3"]) -> Float[np.ndarray, "n_u n_v 3"]:
    """The normal of a surface at each node of a grid on it, as long as the area around it."""
    return np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1))
