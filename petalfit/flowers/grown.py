"""A flower as grids of points, from which its files and pictures are made."""

from __future__ import annotations

import os
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.flowers.flower import Flower, Part
from petalfit.flowers.settings import FlowerError
from petalfit.surfaces import AbstractSurface

# Vertices along u and along v. Petals need more, because they have ribs and a midrib.
PETAL, ROUND = (65, 33), (25, 17)
# The number of surfaces evaluated at a time, so that flowers of any size share one compiled program.
_AT_ONCE = 16
# Memory per vertex while a file is written, with normals, texture coordinates, faces and copies.
_BYTES = 400


class Grown(NamedTuple):
    """The same part of all k organs of a series, on a grid of its domain.

    Attributes:
        part: The part, with NumPy arrays as leaves.
        vertices: The vertices in the frame of the part, shape (k, n_u, n_v, 3).
        normals: The unit normals at the vertices, shape (k, n_u, n_v, 3).
        inner: The matrices from the part's frame to the organ's, shape (k, 4, 4).
        outer: The matrices from the organ's frame to the flower's, shape (k, 4, 4).
    """

    part: Part
    vertices: Float[np.ndarray, "k n_u n_v 3"]
    normals: Float[np.ndarray, "k n_u n_v 3"]
    inner: Float[np.ndarray, "k 4 4"]
    outer: Float[np.ndarray, "k 4 4"]

    def in_flower(self) -> Grown:
        """A copy with vertices and normals in the flower's frame; the matrices are unchanged."""
        matrices = self.outer @ self.inner
        scale = np.cbrt(np.linalg.det(matrices[:, :3, :3]))[:, None, None]
        return self._replace(
            vertices=_turned(self.vertices, matrices[:, :3, :3]) + matrices[:, None, None, :3, 3],
            normals=_turned(self.normals, matrices[:, :3, :3] / scale),
        )


def _turned(
    vectors: Float[np.ndarray, "k n_u n_v 3"], matrices: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "k n_u n_v 3"]:
    return vectors @ np.swapaxes(matrices, 1, 2)[:, None]


def resolution(surface: AbstractSurface, finer: int = 1) -> tuple[int, int]:
    """The numbers of vertices along u and along v for a surface, with `finer` times the usual cells."""
    n_u, n_v = PETAL if all(surface.edges) else ROUND
    return finer * (n_u - 1) + 1, finer * (n_v - 1) + 1


def grow(flower: Flower, finer: int = 1) -> list[Grown]:
    """Evaluates all surfaces of a flower on grids.

    Args:
        flower: The flower.
        finer: How many times as fine the grids are, along both sides, as those of its files.

    Raises:
        FlowerError: The grids would not fit into memory.
    """
    with jax.enable_x64(True):
        shapes = [
            (len(part.outer.translation), *resolution(part.surface, finer))
            for part in jax.eval_shape(_parts, flower)
        ]
        require_memory(float(np.sum(np.prod(shapes, axis=1, dtype=float))))
        return [_grown(jax.tree.map(np.asarray, part), finer) for part in _placed(flower)]


def require_memory(vertices: float) -> None:
    """Checks, before a flower is grown, that its vertices fit into memory.

    Raises:
        FlowerError: The vertices would take more than half of the free memory.
    """
    needed, free = _BYTES * vertices, _free_memory()
    if needed > 0.5 * free:
        raise FlowerError(
            f"the flower would have {vertices:.3g} vertices and take some {needed / 1e9:.2g} GB to grow, "
            f"where {free / 1e9:.2g} GB are free: give it fewer organs."
        )


def _free_memory() -> float:
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):  # Windows and macOS do not report it
        return 8e9


def _parts(flower: Flower) -> list[Part]:
    return flower.parts()


def _sheets(surface: AbstractSurface, u: Array, v: Array) -> tuple[Array, Array]:
    def sheet(one: AbstractSurface) -> tuple[Array, Array]:
        return one(u[:, None], v[None, :]), one.normal(u[:, None], v[None, :])

    return jax.vmap(sheet)(surface)


_placed = Program(_parts)
_sheet = Program(_sheets)


def _grown(part: Part, finer: int) -> Grown:
    shape = resolution(part.surface, finer)
    u, v = (np.linspace(*side, n) for side, n in zip(part.surface.domain, shape, strict=True))
    k = len(part.outer.translation)
    rows = []
    for first in range(0, k, _AT_ONCE):
        which = np.minimum(np.arange(first, first + _AT_ONCE), k - 1)
        some = jax.tree.map(lambda leaf, which=which: leaf[which], part.surface)
        rows.append([np.asarray(array)[: k - first] for array in _sheet(some, u, v)])
    vertices, normals = (np.concatenate(arrays) for arrays in zip(*rows, strict=True))
    return Grown(part, vertices, normals, part.inner.matrix(), part.outer.matrix())
