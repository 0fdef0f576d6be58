"""The search for foot points: steps from given starts, then new starts for those that are in doubt."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from petalfit.residuals.contact import Numbers
from petalfit.residuals.programs import places, slide_foot_points
from petalfit.surfaces import AbstractMap

_SIDES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_PARTS, _NODES = 8, 4  # parts of the domain per side, and nodes per side of a part
_STEPS = 8  # from new starts


def refine_foot_points(
    surface: AbstractMap,
    points: Float[Numbers, "n 3"],
    uv: Float[Numbers, "n 2"],
    iterations: int,
    around: bool = True,
) -> Float[np.ndarray, "n 2"]:
    """Minimises |S(u, v) − x| over the surface's domain for every point, from the starts `uv`.

    After the steps of `newton`, two kinds of points search for a better minimum. Those that still move or
    are weakly determined (between two layers that meet at a fold, or two ribs) search nearby; the
    farthest points search everywhere.

    Args:
        surface: Any surface.
        points: The points x, in the surface's frame.
        uv: The start of every point, inside the domain.
        iterations: The number of Newton steps; two from a good start, six from a coarse one.
        around: Whether points search for a better minimum at all.

    Returns:
        Foot points, never farther from `points` than `uv` was.
    """
    uv, doubt, squared = slide_foot_points(surface, points, uv, iterations)
    if not around or not len(uv):
        return uv
    points, n = np.asarray(points), len(uv)
    doubtful, far = _most(doubt, max(32, n // 32)), _most(squared, max(32, n // 64))
    which = np.concatenate([doubtful, far])
    new = [_places_nearby(surface, uv[doubtful]), _places_to_look(surface, points[far])]
    starts = np.concatenate([uv[which][None], np.concatenate(new, axis=1)])
    rows = np.tile(points[which], (len(starts), 1))
    found, _, reached = slide_foot_points(surface, rows, starts.reshape(-1, 2), _STEPS)
    reached = reached.reshape(starts.shape[:2])
    closest, column = np.argmin(reached, axis=0), np.arange(len(which))
    better = reached[closest, column] < squared[which]
    uv[which[better]] = found.reshape(starts.shape)[closest, column][better]
    return uv


def _most(values: Float[np.ndarray, " n"], count: int) -> np.ndarray:
    """Indices of the largest values, at most `count` of them."""
    if count >= len(values):
        return np.arange(len(values))
    return np.sort(np.argpartition(-values, count - 1)[:count])


def _places_nearby(
    surface: AbstractMap, uv: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "4 n 2"]:
    """Starts on all four sides of given places."""
    low, high = np.array(surface.domain).T
    return np.clip(uv + 0.04 * (high - low) * _SIDES[:, None], low, high)


def _places_to_look(
    surface: AbstractMap, points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "4 n 2"]:
    """Starts in four different parts of the domain: the nearest node of each part.

    Where a surface folds over itself, the nearest node of all may lie on the wrong layer.
    """
    side = (np.arange(_PARTS * _NODES) + 0.5) / (_PARTS * _NODES)
    low, high = np.array(surface.domain).T
    share = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    shape = _PARTS, _NODES, _PARTS, _NODES, 2
    share = share.reshape(shape).transpose(0, 2, 1, 3, 4).reshape(_PARTS**2, _NODES**2, 2)
    uv = low + (high - low) * share
    nodes = places(surface, uv.reshape(-1, 2))
    squared = np.sum(nodes**2, axis=-1) - 2.0 * points @ nodes.T
    squared = squared.reshape(len(points), _PARTS**2, _NODES**2)
    parts = np.argsort(np.min(squared, axis=-1), axis=-1, kind="stable")[:, :4].T
    nearest = np.argmin(squared[np.arange(len(points)), parts], axis=-1)
    return uv[parts, nearest]
