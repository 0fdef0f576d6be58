"""Sheets beside the one to fit: a table under a petal, and its stalk.

They are as dense and as smooth as the petal, so that no single point shows what it belongs to. They are
told from it as whole sheets.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, KDTree

from petalfit.fitting.likelihood.scales import spacing
from petalfit.fitting.outliers.local_planes import nearest_plane, on_sheets
from petalfit.fitting.segmentation import FEWEST, Sheets, sheets_of

_MOST = 6000  # points that sheets are found among; of more, each goes with the nearest of these
_FLAT = 2.0  # root mean square height of a plane, in standard deviations of the noise
# Least number of a table's points, by that of all others. Flat parts of a petal have fewer.
_TABLE = 0.4
# Least share of the points that a table leaves for a petal, and the share from which that may lie beside
# it: of a smaller one so many points must lie over the table.
_LEFT, _BESIDE, _OVER = 0.05, 0.35, 0.6
_WITHIN = 5.0  # standard deviations from the plane of a table, up to which a point belongs to it
# Least share of the largest sheet, which is the petal, in what is no table; and the largest size of a
# stalk by that of the petal.
_MAIN, _PART = 0.7, 0.5
_NEAR = 2.0  # spacings, up to which points belong together
# Fewest points of a stalk, its width by its length at most, and how far by its length it leads away.
_FEW, _THIN, _AWAY = 25, 0.5, 0.5
_ROUND = 0.2  # mean square of the normals of a stalk in the second of their three directions
_AROUND = 12  # points that a normal is found with


def on_other_sheets(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether each point lies on a table, a plane with many points, or on a stalk, which is round.

    Parts of the petal itself, between its creases and ribs or scanned apart, are none of these.

    Args:
        points: Shape (n, 3).
    """
    found = _others(points, thin=False)
    # Beside a large and flat table, what is bent and small does not seem to lie on a sheet at all.
    if found.any():
        found[~found] = _others(points[~found], thin=True)
    return found


def _others(points: Float[np.ndarray, "n 3"], thin: bool) -> Bool[np.ndarray, " n"]:
    """Whether each point lies on a table, or on a stalk that shows beside it.

    Args:
        points: Shape (n, 3).
        thin: Whether a stalk may be so thin that its points do not seem to lie on a sheet. Clutter could
            be threaded to such stalks, so another sheet must have been found before.
    """
    if len(points) > _MOST:
        some = points[np.random.default_rng(0).permutation(len(points))[:_MOST]]
        nearest = np.asarray(KDTree(some).query(points, workers=-1)[1])
        return _others(some, thin)[nearest]
    found, likely = np.zeros(len(points), bool), on_sheets(points)
    if np.count_nonzero(likely) < FEWEST:
        return found
    seen = points[likely]
    sheets = sheets_of(seen)
    if not sheets.count:
        return found
    tree = KDTree(seen)
    near = _NEAR * spacing(tree)
    sheet = sheets.labels
    tables = np.append(_are_tables(seen, sheets), False)[sheet]  # −1 finds the last entry
    sizes = np.bincount(sheet[~tables & (sheet >= 0)], minlength=sheets.count)
    small = ~tables & (np.append(sizes, 0)[sheet] <= _PART * np.max(sizes))
    gaps, nearest = map(np.asarray, tree.query(points))
    for table in np.unique(sheet[tables]):
        middle, normal, height = _plane(seen[sheet == table])
        within = np.abs((points - middle) @ normal) < _WITHIN * height
        found |= (gaps < near) & (sheet[nearest] == table) & within
    petal = seen[sheet == np.argmax(sizes)]
    # A petal of many sheets, between its creases and ribs, cannot be told from its stalk.
    if len(petal) > _MAIN * np.count_nonzero(~tables):
        rest = np.concatenate(
            [np.flatnonzero(likely)[small], np.flatnonzero(~likely & ~found & thin)]
        )
        found[rest] = _are_stalks(points[rest], petal, near)
    # Where the petal touches them, the fit will tell.
    left = seen[~tables & ~found[likely]]
    found[found] = np.asarray(KDTree(left).query(points[found])[0]) > near / 2
    return found


def _are_tables(points: Float[np.ndarray, "n 3"], sheets: Sheets) -> Bool[np.ndarray, " k"]:
    """Whether each sheet is a table: a plane with many points, that leaves enough for a petal."""
    inside = [points[sheets.labels == label] for label in range(sheets.count)]
    sizes = np.array([len(part) for part in inside], int)
    flat = np.array([_plane(part)[2] < _FLAT * sheets.noise for part in inside], bool)
    tables = flat & (sizes > _TABLE * (sizes.sum() - sizes))
    left = points[~np.append(tables, True)[sheets.labels]]
    share = len(left) / len(points)
    if share < _LEFT:
        return np.zeros(sheets.count, bool)
    for k in np.flatnonzero(tables):
        tables[k] = share > _BESIDE or _share_over(inside[k], left) > _OVER
    return tables


def _plane(
    points: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], float]:
    """The middle of points, the normal of the plane nearest to them, and their rms distance from it."""
    (middle,), (normal,), (height,) = nearest_plane(points[None], np.ones((1, len(points))))
    return middle, normal, float(height)


def _are_stalks(
    points: Float[np.ndarray, "m 3"], petal: Float[np.ndarray, "n 3"], near: float
) -> Bool[np.ndarray, " m"]:
    """Whether each point lies on a stalk: a thin and round group of points that leads away from a petal.

    Args:
        points: Points that may lie on one.
        petal: Points of the petal.
        near: The distance up to which points belong together.
    """
    found = np.zeros(len(points), bool)
    if not len(points):
        return found
    links = KDTree(points).query_pairs(near, output_type="ndarray")
    graph = coo_array((np.ones(len(links)), links.T), shape=(len(points), len(points)))
    away = np.asarray(KDTree(petal).query(points)[0])
    count, groups = connected_components(graph, directed=False)
    for k in range(count):
        group = groups == k
        if not _FEW <= np.count_nonzero(group) <= _PART * len(petal):
            continue
        some = points[group]
        _, sides, axes = np.linalg.svd(some - some.mean(axis=0), full_matrices=False)
        leads_away = np.max(away[group]) > _AWAY * np.ptp(some @ axes[0])
        found[group] = leads_away and sides[1] < _THIN * sides[0] and _roundness(some) > _ROUND
    return found


def _roundness(points: Float[np.ndarray, "n 3"]) -> float:
    """How much the normals of points point in a second direction too: ½ on a tube, 0 on a plane."""
    near = np.asarray(KDTree(points).query(points, _AROUND)[1])
    _, normals, _ = nearest_plane(points[near], np.ones(near.shape))
    return float(np.linalg.eigvalsh(normals.T @ normals / len(points))[1])


def _share_over(table: Float[np.ndarray, "m 3"], points: Float[np.ndarray, "n 3"]) -> float:
    """The share of points that lie over a plane piece of a surface, as those of an object on a table."""
    middle, normal, _ = _plane(table)
    across = np.linalg.svd(normal[None])[2][1:].T  # two directions in the plane
    flat = Delaunay((table - middle) @ across)
    return float(np.mean(flat.find_simplex((points - middle) @ across) >= 0))
