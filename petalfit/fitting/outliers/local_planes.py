"""Local planes: they show which points lie on a surface, before there is any model of it.

Among much clutter a sheet is hardly denser than what surrounds it, but its points lie in a plane with
their neighbours. In the ball around every point a mixture of a plane and of evenly spread clutter is
fitted. A point then has the votes of all planes that it lies in, each with the evidence for its plane
(compare tensor voting; Medioni, Lee and Tang, 2000).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from petalfit.fitting.likelihood.scales import geman_mcclure, spacing, spread_of

_NEIGHBOUR = 8  # the distance to this neighbour measures the density around a point
_PLANE = 12  # neighbours that a local plane is fitted to
_BALL = 24  # neighbours in a ball that may be crossed by a sheet
_NORMALS = 24  # directions that normals are tried in first
# Standard deviations of a sheet, in radii of its ball: to start from, and at least and at most.
_THICK, _THINNEST, _THICKEST = 0.15, 0.03, 0.3
_FITTED = 12  # iterations of the expectation maximisation in a ball
_CHANCE = 4.0  # the log likelihood that a plane through clutter gains by chance
_APART = 1.8  # geometric means of their standard deviations, between two groups that are not one
_GROUPED = 60  # iterations of the expectation maximisation of groups
_FLAT = 0.14  # in distances to the eighth neighbour
_SPARSE = 2.5  # a point is isolated beyond this many median neighbour distances
_OFF = 4.0  # a point is off its local plane beyond this many robust standard deviations
_ROUNDS = 3
_FEWEST = 32
_MOST = 20_000  # points that are tested
_BESIDE = 2.0  # spacings of the tested points, up to which another one lies beside them


def on_sheets(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether each point seems to lie on a surface: in a dense place, near its neighbours' plane.

    Nearly all points of a surface are kept, however it is bent, and a tenth of the clutter that fills
    the surface's own box: of what is kept, some 5 % is clutter if there is as much of it as of the
    surface, and 20 to 30 % if there is four times as much. The test knows no model: what it keeps is good
    to start a search with, but is no final decision.

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
    """Whether each point lies in a sheet, if some do and some do not; else whether it has neighbours."""
    evidence, far = _evidence(points)
    sheet, apart = _two_groups(evidence)
    if apart > _APART and not _flat(points, ~sheet):
        return sheet
    return far <= 3 * np.median(far)


def _evidence(
    points: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The evidence that each point lies in a sheet, as a logarithm, and how far its neighbours reach.

    It consists of the votes of the planes around the point, and of the density there.
    """
    count = min(_BALL, len(points) - 1)
    gaps, near = map(np.asarray, KDTree(points).query(points, count + 1))
    far = np.maximum(gaps[:, -1], 1e-3 * np.median(gaps[:, -1]) + 1e-300)
    members, gain = _planes_in_balls((points[near] - points[:, None]) / far[:, None, None])
    votes = np.zeros(len(points))
    np.add.at(votes, near, np.maximum(gain - _CHANCE, 0.0)[:, None] * members)
    return np.log1p(votes / (count + 1)) - 2 * np.log(far), gaps[:, min(_NEIGHBOUR, count)]


def _planes_in_balls(
    ball: Float[np.ndarray, "n k 3"],
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, " n"]]:
    """The likeliest mixture of a plane and clutter in unit balls, by expectation maximisation.

    Args:
        ball: Points in each ball, relative to its middle.

    Returns:
        The probability that each point lies in the plane of its ball, and the log likelihood that the
        plane gains over clutter alone.
    """
    share, level, thick = (np.full(len(ball), x) for x in (0.5, 0.0, _THICK))
    normals = _half_sphere(_NORMALS)
    tried = [_ratio(ball @ normal, share, level, thick) for normal in normals]
    gains = np.stack([np.log1p(ratio).sum(axis=1) for ratio in tried])
    normal = normals[np.argmax(gains, axis=0)]
    for _ in range(_FITTED):
        ratio = _ratio(np.einsum("nki,ni->nk", ball, normal), share, level, thick)
        members = ratio / (1 + ratio)
        share = np.clip(members.mean(axis=1), 0.05, 0.95)
        middle, normal, deviation = nearest_plane(ball, members)
        level = np.einsum("ni,ni->n", middle, normal)
        thick = np.clip(deviation, _THINNEST, _THICKEST)
    ratio = _ratio(np.einsum("nki,ni->nk", ball, normal), share, level, thick)
    gain = np.sum(np.log((1 - share)[:, None] * (1 + ratio)), axis=1)
    return ratio / (1 + ratio), gain


def _half_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Directions that are evenly spread over half of the sphere, on a golden spiral."""
    k = np.arange(count) + 0.5
    height, angle = k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=-1)


def _ratio(
    height: Float[np.ndarray, "n k"],
    share: Float[np.ndarray, " n"],
    level: Float[np.ndarray, " n"],
    thick: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n k"]:
    """How much likelier than clutter a plane is for points at these heights in a unit ball."""
    share, level, thick = share[:, None], level[:, None], thick[:, None]
    on = np.exp(-0.5 * ((height - level) / thick) ** 2) / (np.sqrt(2 * np.pi) * thick)
    clutter = 0.75 * np.maximum(1 - height**2, 0.05)
    return share / (1 - share) * on / clutter


def _two_groups(values: Float[np.ndarray, " n"]) -> tuple[Bool[np.ndarray, " n"], float]:
    """Which values belong to the upper of two groups, and how far apart the groups are.

    The groups are those with the largest variance between them (Otsu, 1979). How far apart they are is
    the difference of the means of the likeliest two Gaussians, in geometric means of their deviations:
    up to 1.7 for points of a surface, 2 and more if there is clutter.
    """
    ordered = np.sort(values)
    n, below = len(ordered), np.arange(1, len(ordered))
    sums = np.cumsum(ordered)[:-1]
    between = (sums / below - ordered.mean()) ** 2 * below / (n - below)
    upper = values > ordered[int(np.argmax(between))]
    if not 0 < np.count_nonzero(upper) < n:
        return upper, 0.0
    least = 1e-3 * (np.ptp(values) + 1e-300)
    members = np.stack([~upper, upper]).astype(float)
    middle = deviation = np.ones((2, 1))
    for _ in range(_GROUPED):
        total = members.sum(axis=1, keepdims=True) + 1e-300
        middle = (members @ values)[:, None] / total
        deviation = (
            np.sqrt(np.sum(members * (values - middle) ** 2, axis=1)[:, None] / total) + least
        )
        logs = np.log(total / deviation) - 0.5 * ((values - middle) / deviation) ** 2
        members = np.exp(logs - logs.max(axis=0))
        members /= members.sum(axis=0)
    return upper, float((middle[1, 0] - middle[0, 0]) / np.sqrt(np.prod(deviation)))


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
        middle, normal, _ = nearest_plane(around, weights)
        off = np.einsum("nki,ni->nk", around - middle[:, None], normal)
        scale = 2 * np.median(np.abs(off), axis=1, keepdims=True) + 1e-300
        weights = geman_mcclure(off, scale)
    return gaps[:, _NEIGHBOUR], np.einsum("ni,ni->n", points - middle, normal)


def nearest_plane(
    points: Float[np.ndarray, "n k 3"], weights: Float[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Middles and normals of the planes nearest to groups of points, and root mean square distances."""
    total = weights.sum(axis=1) + 1e-300
    middle = np.einsum("nk,nki->ni", weights, points) / total[:, None]
    centred = points - middle[:, None]
    spread = np.einsum("nk,nki,nkj->nij", weights, centred, centred) / total[:, None, None]
    squares, axes = np.linalg.eigh(spread)
    return middle, axes[:, :, 0], np.sqrt(np.maximum(squares[:, 0], 0.0))
