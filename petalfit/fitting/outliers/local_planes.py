"""Local planes: they show which points lie on a surface, before there is any model of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from petalfit.fitting.likelihood.scales import geman_mcclure, spacing, spread_of

_NEIGHBOUR = 8  # the distance to this neighbour measures the density around a point
_PLANE = 12  # neighbours that a local plane is fitted to
_SPLIT = 0.7  # part of the variance between two groups, from which there are two densities, not one
_FLAT = 0.12  # in distances to the eighth neighbour
_SPARSE = 2.5  # a point is isolated beyond this many median neighbour distances
_OFF = 4.0  # a point is off its local plane beyond this many robust standard deviations
_ROUNDS = 3
_FEWEST = 32
_MOST = 20_000  # points that are tested
_BESIDE = 2.0  # spacings of the tested points, up to which another one lies beside them


def on_sheets(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether each point seems to lie on a surface: in a dense place, near its neighbours' plane.

    Nearly all points of a surface are kept, however it is bent, and a tenth of the clutter if that is a
    third of all points and fills the surface's own box. The test knows no model: what it keeps is good to
    start a search with, but is no final decision.

    Of a large cloud some points are tested, and the others are kept beside those that are.

    Args:
        points: Shape (n, 3).
    """
    if len(points) > _MOST:
        some = points[np.random.default_rng(0).permutation(len(points))[:_MOST]]
        tree = KDTree(some[on_sheets(some)])
        return np.asarray(tree.query(points, workers=-1)[0]) < _BESIDE * spacing(tree)
    kept = np.arange(len(points))
    if len(kept) > _FEWEST:
        kept = kept[_dense(points)]
    for _ in range(_ROUNDS):
        if len(kept) <= _FEWEST:
            break
        far, off = _local_planes(points[kept])
        flat = np.abs(off) <= _OFF * spread_of(off)
        kept = kept[flat & (far <= _SPARSE * np.median(far))]
    found = np.zeros(len(points), bool)
    found[kept] = True
    return found


def _dense(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether each point lies in the denser of two groups, if there are two densities (Otsu, 1979)."""
    far = np.asarray(KDTree(points).query(points, _NEIGHBOUR + 1)[0])[:, -1]
    logs = np.log(np.maximum(far, 1e-3 * np.median(far) + 1e-300))
    ordered = np.sort(logs)
    n, below = len(ordered), np.arange(1, len(ordered))
    sums = np.cumsum(ordered)[:-1]
    between = (sums / below - ordered.mean()) ** 2 * below / (n - below)
    split = int(np.argmax(between))
    sparse = logs > ordered[split]
    if between[split] >= _SPLIT * ordered.var() and not _flat(points, sparse):
        return ~sparse
    return far <= 3 * np.median(far)


def _flat(points: Float[np.ndarray, "n 3"], some: Bool[np.ndarray, " n"]) -> bool:
    """Whether some points lie on a surface that was scanned less densely than the rest.

    Clutter lies 0.16 to 0.3 distances to the eighth neighbour away from its neighbours' plane (medians,
    for shares of 80 to 10 %), points of a surface less than 0.1.
    """
    far, off = _local_planes(points)
    return float(np.median(np.abs(off[some]) / (far[some] + 1e-300))) < _FLAT


def _local_planes(
    points: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The distances of every point to its eighth neighbour, and from the plane near its neighbours."""
    tree = KDTree(points)
    gaps, near = map(np.asarray, tree.query(points, _PLANE + 1))
    around = points[near[:, 1:]]
    weights = np.ones(around.shape[:2])
    middle = normal = np.zeros_like(points)
    for _ in range(4):
        total = weights.sum(axis=1)
        middle = np.einsum("nk,nki->ni", weights, around) / total[:, None]
        centred = around - middle[:, None]
        spread = np.einsum("nk,nki,nkj->nij", weights, centred, centred)
        normal = np.linalg.eigh(spread)[1][:, :, 0]
        off = np.einsum("nki,ni->nk", centred, normal)
        scale = 2 * np.median(np.abs(off), axis=1, keepdims=True) + 1e-300
        weights = geman_mcclure(off, scale)
    return gaps[:, _NEIGHBOUR], np.einsum("ni,ni->n", points - middle, normal)
