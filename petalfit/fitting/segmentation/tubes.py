"""Tubes, such as stalks, pistils and thick filaments: points all around an axis that are no petal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

_LONG = 2.0  # length of a piece of a tube, by its breadth, at the least
_NEAR = 3.0  # noise within which a point lies on the circle
_ROUND = 0.12  # and the part of the radius by which a tube may differ from a circle
_HOLLOW = 0.7  # radii within which a tube has hardly any points
_SECTORS = 12
_AROUND = 0.8  # part of the sectors that have points
_FULL = 0.25  # points within, by those on the circle, at the most
_MOST = 0.5  # part of a segment's points in slices of tubes, from which it is a piece of one
_FEWEST = 8  # points of a slice
_FITS = 4


class _Slice(NamedTuple):
    """The points of a cloud around a short piece of a segment's axis.

    Attributes:
        inside: Indices of the points.
        flat: Their places in the plane across the axis, relative to a place near the axis.
        own: Whether each of them belongs to the segment.
    """

    inside: Int[np.ndarray, " k"]
    flat: Float[np.ndarray, "k 2"]
    own: Bool[np.ndarray, " k"]


def on_tubes(
    points: Float[np.ndarray, "n 3"],
    segments: Sequence[Int[np.ndarray, " _"]],
    noise: float,
) -> Bool[np.ndarray, " n"]:
    """Whether each point lies on a tube.

    A thin tube falls into several segments, each of which has a part of the way around. A segment is
    therefore cut into short slices across its length, and a circle is fitted in each of them to all
    points around. Where the circle is closed and hollow, the slice is one of a tube; petals may stand
    around it.

    Args:
        points: The points.
        segments: The indices of the points of each segment that may be a piece of a tube.
        noise: Standard deviation of the points' distances from their sheets.
    """
    tree, found = KDTree(points), np.zeros(len(points), bool)
    for segment in segments:
        round_about = np.zeros(len(points), bool)
        for part in _slices(points, segment, tree):
            round_about[part.inside[_on_circle(part, noise)]] = True
        if np.mean(round_about[segment]) >= _MOST:
            found |= round_about
            found[segment] = True
    return found


def _slices(
    points: Float[np.ndarray, "n 3"], segment: Int[np.ndarray, " m"], tree: KDTree
) -> Iterator[_Slice]:
    """The slices of a segment, none if it is not long."""
    own = points[segment]
    direction, breadth = _axis(own)
    along = (own - own.mean(axis=0)) @ direction
    if np.ptp(along) < _LONG * breadth:
        return
    count = int(np.ceil(2 * np.ptp(along) / breadth))
    for place in np.linspace(along.min(), along.max(), 2 * count + 1)[1::2]:
        near = np.abs(along - place) < breadth
        if np.count_nonzero(near) < _FEWEST:
            continue
        local, _ = _axis(own[near])
        middle = own[near].mean(axis=0)
        inside = np.array(sorted(tree.query_ball_point(middle, 2 * breadth)))
        way = points[inside] - middle
        level = np.abs(way @ local) < breadth / 2
        across = np.linalg.svd(local[None])[2][1:]
        yield _Slice(inside[level], way[level] @ across.T, np.isin(inside[level], segment))


def _axis(points: Float[np.ndarray, "m 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """The direction in which points reach the farthest, and how far they reach across it."""
    way = points - points.mean(axis=0)
    axes = np.linalg.svd(way, full_matrices=False)[2]
    return axes[0], float(np.ptp(way @ axes[1]))


def _on_circle(part: _Slice, noise: float) -> Bool[np.ndarray, " k"]:
    """Which points of a slice lie on a closed and hollow circle; none if there is none."""
    on, middle, radius = part.own, np.zeros(2), 0.0
    for _ in range(_FITS):
        if np.count_nonzero(on) < _FEWEST:
            return np.zeros(len(on), bool)
        middle, radius = _circle(part.flat[on])
        away = np.linalg.norm(part.flat - middle, axis=1)
        on = np.abs(away - radius) < _NEAR * noise + _ROUND * radius
    way = part.flat[on] - middle
    sectors = np.floor(np.arctan2(way[:, 1], way[:, 0]) / (2 * np.pi) * _SECTORS).astype(int)
    around = len(np.unique(sectors % _SECTORS)) / _SECTORS
    within = np.linalg.norm(part.flat - middle, axis=1) < _HOLLOW * radius
    closed = around >= _AROUND and np.count_nonzero(within) < _FULL * np.count_nonzero(on)
    return on if closed else np.zeros(len(on), bool)


def _circle(places: Float[np.ndarray, "k 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """The circle for which |x|² − 2 c·x − (r² − |c|²) has the least squares."""
    matrix = np.column_stack([2 * places, np.ones(len(places))])
    solved = np.linalg.lstsq(matrix, np.sum(places**2, axis=1), rcond=None)[0]
    middle = solved[:2]
    return middle, float(np.sqrt(max(solved[2] + middle @ middle, 0.0)))
