"""Whether points are the same when they are turned, as those of a disc, a square or a star are."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

# Parts of a full turn; the half is left out, since a leaf may have two ends alike.
_TURNS = (3, 4, 5)
_FEWEST = 250  # points, below which their gaps are as wide as the differences that are looked for
_MOST = 1000  # points that are turned
_ALIKE = 0.2  # of two variances, the greatest difference relative to their sum
_STEPS = 6  # in which the turned points are moved to where they fit best
_ASIDE = np.radians(12.0)  # by how much they may be turned besides
# A point has none beside it if the nearest is farther than so many typical gaps, which of points that
# are spread evenly happens to one in 500.
_GAPS = 3.0


def alone_when_turned(points: Float[np.ndarray, "n 3"]) -> float:
    """The part of the points that have none beside them after a turn, the least for all turns.

    Turned are a third, a quarter and a fifth of a full turn, about each principal axis around which the
    points spread evenly.

    Args:
        points: Points of a surface.

    Returns:
        The part, from 0 to 1; 1 if no turn comes into question or there are too few points.
    """
    if len(points) < _FEWEST:
        return 1.0
    if len(points) > _MOST:
        points = points[np.random.default_rng(0).permutation(len(points))[:_MOST]]
    points = points - points.mean(axis=0)
    variances, axes = np.linalg.eigh(points.T @ points)
    tree, least = KDTree(points), 1.0
    gap = float(np.median(np.asarray(tree.query(points, 2)[0])[:, 1]))
    for k in range(3):
        one, other = np.delete(variances, k)
        if abs(one - other) > _ALIKE * (one + other):
            continue
        for part in _TURNS:
            turn = Rotation.from_rotvec(2 * np.pi / part * axes[:, k])
            least = min(least, _alone(tree, turn, _GAPS * gap))
    return least


def _alone(tree: KDTree, turn: Rotation, away: float) -> float:
    """The part of the points of a tree that have none beside them when they are turned."""
    points = np.asarray(tree.data)
    turned, besides = turn.apply(points), Rotation.identity()
    for _ in range(_STEPS):
        gaps, nearest = map(np.asarray, tree.query(turned))
        close = gaps <= np.quantile(gaps, 0.9)
        here, there = turned[close], points[nearest[close]]
        middle, goal = here.mean(axis=0), there.mean(axis=0)
        step = Rotation.align_vectors(there - goal, here - middle)[0]
        besides = step * besides
        if besides.magnitude() > _ASIDE:
            break
        turned = step.apply(turned - middle) + goal
    return float(np.mean(np.asarray(tree.query(turned)[0]) > away))
