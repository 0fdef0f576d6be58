"""Compiled programs of the fits, beside those of `petalfit.residuals.programs`."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.residuals import Numbers, frames, places
from petalfit.surfaces import AbstractMap, AbstractSurface


def _positions(surfaces: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "k n 3"]:
    """Positions on a batch of surfaces, whose leaves have shape (k,)."""
    return jax.vmap(lambda surface: surface.position(uv[:, 0], uv[:, 1]))(surfaces)


positions = Program(_positions)


def distances(
    surface: AbstractMap, points: Float[Numbers, "n 3"], uv: Float[Numbers, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Distances from points to their foot points."""
    return np.linalg.norm(np.asarray(points) - places(surface, uv), axis=-1)


def beside(
    surface: AbstractSurface, points: Float[Numbers, "n 3"], uv: Float[Numbers, "n 2"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Signed normal distances, and distances beyond the nearest edge, negative inside."""
    here = frames(surface, uv)
    return here.distance(points), np.max(here.beyond(points), axis=-1)
