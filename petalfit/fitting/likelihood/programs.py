"""Compiled programs that all families share: few and small, because a first fit must compile them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.fitting.coordinates import Coordinates, Numbers
from petalfit.fitting.likelihood.linearise import linearise as _linearise
from petalfit.residuals import (
    ContourDistance,
    frame,
    nearest_nodes,
    pull_back,
    refine_foot_points,
)
from petalfit.surfaces import AbstractMap, AbstractSurface


def _positions(surfaces: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "k n 3"]:
    """Positions on a batch of surfaces, whose leaves have shape (k,)."""
    return jax.vmap(lambda surface: surface.position(uv[:, 0], uv[:, 1]))(surfaces)


def _distances(
    surface: AbstractSurface, points: Float[Array, "n 3"], uv: Float[Array, "n 2"]
) -> Float[Array, " n"]:
    """Distances from points to their foot points."""
    return jnp.linalg.norm(points - surface.position(uv[:, 0], uv[:, 1]), axis=-1)


distances = Program(_distances)


def _places(surface: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    return surface.position(uv[:, 0], uv[:, 1])


places = Program(_places)


def _contour_slopes(
    coordinates: Coordinates, t: Float[Array, " p"], term: ContourDistance
) -> Float[Array, "n p"]:
    """Derivatives with respect to t of a contour's residuals, in units of its noise."""
    model = coordinates.model(t)
    pulled = pull_back(model, *term.slopes(model))
    return coordinates.gather(pulled) * coordinates.slopes(t)


def _contour_covectors(model: AbstractSurface, term: ContourDistance) -> Float[Array, "n 3"]:
    """Derivatives of a contour's residuals with respect to positions on the surface."""
    return term.slopes(model)[1]


contour_covectors = Program(_contour_covectors)
contour_slopes = Program(_contour_slopes)
positions = Program(_positions)
frames = Program(frame)
nearest = Program(nearest_nodes)
_refine = Program(refine_foot_points)
linearise = Program(_linearise)


def refine(
    surface: AbstractMap,
    points: Numbers,
    uv: Numbers,
    iterations: int,
    around: bool = True,
) -> Float[Array, "n 2"]:
    """See `refine_foot_points`; one compiled program serves both values of `around`."""
    return _refine(surface, points, uv, iterations, around)
