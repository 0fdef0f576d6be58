"""Foot points: initial guesses, a search on all folds, and the distances to them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import minimum_filter

from petalfit.components import Posed
from petalfit.residuals import (
    Numbers,
    frames,
    nearest_nodes,
    places,
    refine_foot_points,
    slide_foot_points,
)
from petalfit.surfaces import AbstractMap, AbstractSurface

_NEARER = 0.9  # another fold must bring the distance below this part of it
_GRID = 129  # nodes per side of the grid on which folds are searched for
_SOUGHT = 16  # number of doubtful points, the farthest, whose foot points are searched for again


def guess_foot_points(
    model: AbstractSurface, points: Float[Numbers, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """Guesses (u, v) of foot points, from which the search for them begins.

    If the surface has a shadow in its plane, the guesses lie straight below or above the points. From the
    nearest place of the surface itself, many searches would end on the wrong wave.
    """
    if isinstance(model, Posed) and model.surface.shadow is not None:
        return straight_below(model.surface.shadow, model.placement.into(np.asarray(points)))
    shadow = model.shadow
    if shadow is None:
        return refine_foot_points(model, points, nearest_nodes(model, points), 6)
    return straight_below(shadow, points)


def nearer_foot_points(
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    uv: Float[np.ndarray, "n 2"],
    doubtful: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "n 2"] | None:
    """Searches for the foot points of doubtful points again, on all folds of the surface.

    The fold straight below a point need not be the one that the point lies on, and no step leads from one
    to the other. The search therefore starts at every local minimum of the distance on a fine grid.

    Args:
        model: The surface.
        points: The points.
        uv: Their foot points.
        doubtful: Indices of the points whose foot points are in doubt.

    Returns:
        All foot points, with nearer ones for some doubtful points; None if no nearer one was found.
    """
    surface, own = model, np.asarray(points)
    if isinstance(model, Posed):
        surface, own = model.surface, model.placement.into(own)
    grid = [np.linspace(*side, _GRID) for side in surface.domain]
    nodes = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1)
    fine = places(surface, nodes.reshape(-1, 2)).reshape(_GRID, _GRID, 3)
    found, moved = np.array(uv), False
    before = distances(surface, own, uv)
    for k in doubtful[np.argsort(-before[doubtful])][:_SOUGHT]:
        squared = np.sum((fine - own[k]) ** 2, axis=-1)
        minima = np.argwhere(squared == minimum_filter(squared, 3, mode="nearest"))
        starts = nodes[tuple(minima.T)]
        same = np.tile(own[k], (len(starts), 1))
        ends, _, _ = slide_foot_points(surface, same, starts, 12)
        reached = distances(surface, same, ends)
        best = int(np.argmin(reached))
        if reached[best] < _NEARER * before[k]:
            found[k], moved = ends[best], True
    return found if moved else None


def straight_below(shadow: AbstractMap, points: Float[Numbers, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """(u, v) of the places in the plane z = 0 that lie straight below or above the points."""
    below = np.asarray(points) * np.array([1.0, 1.0, 0.0])
    return refine_foot_points(shadow, below, nearest_nodes(shadow, below), 6)


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


def signed_distance(
    distance: Float[np.ndarray, " n"], beyond: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Signed distances to a surface with edges: along the normal, or to the edge for points beyond it.

    Args:
        distance: Signed normal distances.
        beyond: Distances beyond the edge, negative inside.
    """
    return np.copysign(np.hypot(distance, np.maximum(beyond, 0.0)), distance)


def whole_distance(
    off: Float[Numbers, "n 3"],
    distance: Float[Numbers, " n"],
    beyond: Float[Numbers, "n 2"],
) -> Float[np.ndarray, " n"]:
    """How far points are from the surface, without the part beyond its edges.

    Some points far from a surface have no foot point that a search can settle on. The way along the
    surface, from the place that was reached to below the point, counts as well: such a point would
    else seem to lie in the surface where it only lies in the tangent plane of that place.

    Args:
        off: The points relative to the places that were reached.
        distance: Normal distances from these places.
        beyond: Distances beyond the edges of u and of v, negative inside.
    """
    over = np.sum(np.maximum(beyond, 0.0) ** 2, axis=-1)
    return np.sqrt(np.maximum(np.sum(np.square(off), axis=-1) - over, np.square(distance)))


def distances_beside(
    surface: AbstractSurface, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Signed normal distances of points, distances beyond the edge (negative inside), and foot points.

    Call it inside `jax.enable_x64(True)`.
    """
    uv = refine_foot_points(surface, points, guess_foot_points(surface, points), 3)
    return *beside(surface, points, uv), uv
