"""Compiled programs that all families share: few and small, because a first fit must compile them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import BLOCK, Program, RowProgram, split_into
from petalfit.fitting.coordinates import Coordinates, Numbers
from petalfit.fitting.likelihood.linearise import Linearisation, together
from petalfit.fitting.likelihood.linearise import linearise as _linearise
from petalfit.residuals import (
    ContourDistance,
    Data,
    estimate_sigma,
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


distances = RowProgram(_distances, (1, 2))


def _beside(
    surface: AbstractSurface, points: Float[Array, "n 3"], uv: Float[Array, "n 2"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Signed normal distances, and distances beyond the nearest edge, negative inside."""
    here = frame(surface, uv)
    return here.distance(points), jnp.max(here.beyond(points), axis=-1)


beside = RowProgram(_beside, (1, 2))


def _places(surface: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    return surface.position(uv[:, 0], uv[:, 1])


places = RowProgram(_places, (1,))


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
frames = RowProgram(frame, (1,))
nearest = RowProgram(nearest_nodes, (1,))
_refine = RowProgram(refine_foot_points, (1, 2))
_linearise_block = Program(_linearise)


def linearise(
    coordinates: Coordinates, data: Data, t: Float[np.ndarray, " p"], uv: Numbers
) -> Linearisation:
    """See `petalfit.fitting.likelihood.linearise`; a large cloud is linearised in blocks."""
    if split_into(len(uv)) == 1:
        return _linearise_block(coordinates, data, t, uv)
    if np.isnan(float(data.sigma)):
        distance = frames(coordinates.model(t), uv).distance(data.points)
        data = data._replace(sigma=estimate_sigma(data, distance, len(t)))
    return linearise_in_blocks(coordinates, data, t, uv)


def linearise_in_blocks(
    coordinates: Coordinates, data: Data, t: Float[np.ndarray, " p"], uv: Numbers
) -> Linearisation:
    """The same for a cloud of given noise whose size is a multiple of `BLOCK`."""
    number = len(uv) // BLOCK
    points, weights, places = (np.split(np.asarray(x), number) for x in (*data[:2], uv))
    parts = [
        (coordinates, Data(jnp.asarray(block), jnp.asarray(weight), data.sigma), t, place)
        for block, weight, place in zip(points, weights, places, strict=True)
    ]
    return together(_linearise_block.map(parts))


def refine(
    surface: AbstractMap,
    points: Numbers,
    uv: Numbers,
    iterations: int,
    around: bool = True,
) -> Float[Array, "n 2"]:
    """See `refine_foot_points`; one compiled program serves both values of `around`."""
    return _refine(surface, points, uv, iterations, around)
