"""Starts of peony petals in an unknown pose: the plane, the outline in it, then heights and tilt.

Seen along the normal of its plane, a petal appears as its outline, which shows how the petal is turned
and where its base is. From either side the outline is nearly the same, so that both sides are tried. A
bend along the petal tilts the plane that lies nearest to its points. Heights above that plane show by how
much, and a second sweep views the cloud from the corrected direction. Last, the waves across the petal
determine turns and shifts in the plane, which an outline with a gap does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from petalfit.components import PeonyPetal
from petalfit.fitting.coordinates import with_values
from petalfit.fitting.families.peony.outline import (
    OUTLINE,
    Heights,
    OutlineSearch,
    fit_amplitudes,
)
from petalfit.residuals import Data
from petalfit.surfaces import turn_between

_DIRECTIONS = 48
_ROLLS = 24
_ANGLES = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
_RAYS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)
_SPARSE = 2.2  # a point is isolated beyond this many median neighbour distances in the plane
_TOLERANCE = 0.02  # unit of differences in support, relative to the largest support
# A part of the petal may be missing, but little of the cloud lies outside of the petal. Support of the
# points beyond that of the outline therefore has more weight, and loses it more slowly.
_OUTSIDE, _SOFT = 3.0, 0.1
_SHIFTS = 4  # iterations of reweighted least squares for the shift
_SPREAD = 3  # batches of evenly spread outlines
_GENERATIONS = 5
_REFINED = 6
_APART = np.radians(12.0)
_FEW = 384  # points that heights are fitted to
_TILTED = 1  # number of planes for a second sweep
_ALIGNED = 8  # number of petals that are aligned by their waves
_TURNS = np.radians(np.linspace(-8.0, 8.0, 33))
# For an unknown unit: units in which outlines are searched for, and relative sizes for waves.
_UNITS = (0.6, 1.0, 1.5)
_SIZES, _SIZES_TRIED = np.geomspace(0.6, 1.7, 53), 2
_SAME = 0.05  # rad, or relative


class Placed(NamedTuple):
    """A petal without ribs in a pose.

    Attributes:
        petal: The petal in its own frame.
        rotation: The rotation from the petal's frame to the cloud's, shape (3, 3).
        translation: The petal's origin in the cloud's frame, shape (3,).
        unit: The length of the petal's unit in the cloud's unit.
        misfit: Median distance of points along the normal of its plane, in the cloud's unit.
    """

    petal: PeonyPetal
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    unit: float
    misfit: float

    def into(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transforms points of the cloud into the petal's frame."""
        return (points - self.translation) @ self.rotation / self.unit

    def apart(self, other: Placed) -> float:
        """The difference from another one: the largest of angle in rad, relative shift and size."""
        turn = turn_between(self.rotation, other.rotation)
        length = self.unit * float(self.petal.b_y)
        shift = np.linalg.norm(self.translation - other.translation) / length
        sizes = [
            np.log(float(getattr(self.petal, name)) / float(getattr(other.petal, name)))
            for name in ("a_x", "b_y")
        ]
        return float(max(turn, shift, *np.abs(sizes)))


class _Flat(NamedTuple):
    """An outline in a plane, turned by an angle and then shifted."""

    values: Float[np.ndarray, "3"]
    angle: float
    shift: Float[np.ndarray, "2"]
    score: float


def placed_petals(
    template: PeonyPetal,
    free: Sequence[str],
    points: Float[np.ndarray, "n 3"],
    pose: str,
    axes: Float[np.ndarray, "3 3"] | None = None,
) -> list[Placed]:
    """Different petals that a cloud may show, the likeliest first.

    Args:
        template: A petal with the values of the parameters that are not free.
        free: Names of the free parameters.
        points: Points, most of which belong to the petal.
        pose: "rigid", or "similarity" if the unit of the points is not the model's; in it, the petal must
            then have roughly the size of typical petals.
        axes: Axes, of which the last is the normal of the petal's plane; None if that is not known.
    """
    units = _UNITS if pose == "similarity" else (1.0,)
    known = _plane(points) if axes is None else axes
    found = [x for unit in units for x in _seen_along(template, free, points, known, unit)]
    for placed in sorted(found, key=_misfit)[:_TILTED] if axes is None else []:
        found += _seen_along(template, free, points, placed.rotation, placed.unit)
    found = _different(found)[:_ALIGNED]
    if "dx" in free:
        sizes = _SIZES if pose == "similarity" else np.ones(1)
        found += [x for placed in found for x in _aligned(placed, free, points, sizes)]
    return _different(found)


def _different(found: list[Placed]) -> list[Placed]:
    """The petals, the likeliest first, without those that nearly equal a better one."""
    chosen: list[Placed] = []
    for placed in sorted(found, key=_misfit):
        if all(placed.apart(other) > _SAME for other in chosen):
            chosen.append(placed)
    return chosen


def _misfit(placed: Placed) -> float:
    return placed.misfit


def _seen_along(
    template: PeonyPetal,
    free: Sequence[str],
    points: Float[np.ndarray, "n 3"],
    axes: Float[np.ndarray, "3 3"],
    unit: float,
) -> list[Placed]:
    """Petals of a given unit whose outlines fit the cloud, seen along the last axis from either side."""
    found = []
    centre = points.mean(axis=0)
    for flat in _outlines(template, free, ((points - centre) @ axes)[:, :2] / unit):
        cosine, sine = np.cos(flat.angle), np.sin(flat.angle)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        petal = with_values(template, dict(zip(OUTLINE, flat.values, strict=True)))
        for side in (1.0, -1.0):
            rotation = axes @ turn @ np.diag([side, 1.0, side])
            origin = centre + unit * axes[:, :2] @ flat.shift
            found.append(_raised(petal, free, points, rotation, origin, unit))
    return found


def _aligned(
    placed: Placed,
    free: Sequence[str],
    points: Float[np.ndarray, "n 3"],
    sizes: Float[np.ndarray, " g"],
) -> Iterator[Placed]:
    """Turns and shifts a petal in its plane, until the waves across it are those of the points.

    The length of the waves is known. The unknowns are a small turn and a phase, and in an unknown unit
    the relative size of the petal. Shifted by half a wave, the other sign of dx fits as well.
    """
    above = _Above.of(placed.petal, free, placed.into(points[:_FEW]))
    root = np.sqrt(1 / (1 + (above.left / (2 * above.misfit + 1e-300)) ** 2))
    rest = np.delete(above.basis, above.names.index("dx"), axis=1)
    basis = np.linalg.qr(root[:, None] * rest)[0]
    own = above.own[:, :2]
    middle = own.mean(axis=0)
    x, y = (own - middle).T
    across = np.outer(np.cos(_TURNS), x) + np.outer(np.sin(_TURNS), y) + middle[0]
    phase = 0.5 * np.pi * sizes[:, None, None] * across
    waves = root * np.stack([np.sin(phase), np.cos(phase)])
    waves = waves - (waves @ basis) @ basis.T
    gram = np.einsum("igtn,jgtn->gtij", waves, waves) + 1e-9 * np.eye(2)
    right = waves @ (root * above.heights)
    pair = np.linalg.solve(gram, np.moveaxis(right, 0, -1)[..., None])[..., 0]
    gain = np.sum(pair * np.moveaxis(right, 0, -1), axis=-1)
    for k in _peaks(gain.max(axis=1)):
        t = int(np.argmax(gain[k]))
        cosine, sine = np.cos(_TURNS[t]), np.sin(_TURNS[t])
        turn = np.array([[cosine, -sine], [sine, cosine]])
        rotation = placed.rotation.copy()
        rotation[:, :2] = rotation[:, :2] @ turn
        # The waves A sin(πx/2 + ψ) are dx sin(π(x - x₀)/2 - ½).
        shift = -(np.arctan2(pair[k, t, 1], pair[k, t, 0]) + 0.5) * 2 / np.pi
        larger = {name: sizes[k] * float(getattr(placed.petal, name)) for name in ("a_x", "b_y")}
        petal = with_values(placed.petal, {n: x for n, x in larger.items() if n in free})
        for half in (0.0, 2.0):
            along = ((shift + half + 2.0) % 4.0 - 2.0) / sizes[k]
            origin = middle + turn @ (np.array([along, 0.0]) - middle)
            place = placed.translation + placed.unit * placed.rotation[:, :2] @ origin
            yield _raised(petal, free, points, rotation, place, placed.unit / sizes[k])


def _peaks(gain: Float[np.ndarray, " g"]) -> list[int]:
    """Indices of the local maxima, the greatest first."""
    before, after = np.append(-np.inf, gain[:-1]), np.append(gain[1:], -np.inf)
    peaks = np.flatnonzero((gain >= before) & (gain > after))
    return peaks[np.argsort(-gain[peaks])][:_SIZES_TRIED].tolist()


def _plane(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3 3"]:
    """Axes, of which the last is the normal of the plane nearest to most points."""
    weights, axes = np.ones(len(points)), np.eye(3)
    for _ in range(8):
        centred = points - np.average(points, axis=0, weights=weights)
        axes = np.linalg.eigh(centred.T @ (weights[:, None] * centred))[1][:, ::-1]
        off = centred @ axes[:, 2]
        weights = 1 / (1 + (off / (2 * np.median(np.abs(off)) + 1e-300)) ** 2)
    axes[:, 2] *= np.linalg.det(axes)
    return axes


class _Above(NamedTuple):
    """Points above a petal's plane, and the amplitudes and the tilt that explain their heights.

    Attributes:
        own: The points in the petal's frame, shape (n, 3).
        names: Names of the free amplitudes.
        basis: Heights for an amplitude of 1 each, then those of a plane (1, x, y), shape (n, k).
        heights: Heights of the points, shape (n,).
        left: Residuals of the heights, shape (n,).
        amplitudes: Coefficients of the basis, shape (k,).
    """

    own: Float[np.ndarray, "n 3"]
    names: tuple[str, ...]
    basis: Float[np.ndarray, "n k"]
    heights: Float[np.ndarray, " n"]
    left: Float[np.ndarray, " n"]
    amplitudes: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, petal: PeonyPetal, free: Sequence[str], own: Float[np.ndarray, "n 3"]) -> _Above:
        """Fits the heights of points above a petal."""
        n = len(own)
        data = Data.of(own, np.ones(n), None)
        found = Heights.of(petal, free, data)
        heights = found.above
        basis = np.column_stack([found.basis, np.ones(n), own[:, :2]])
        amplitudes = fit_amplitudes(heights, basis, np.ones(n))
        return cls(own, found.names, basis, heights, heights - basis @ amplitudes, amplitudes)

    @property
    def misfit(self) -> float:
        return float(np.median(np.abs(self.left)))


def _raised(
    petal: PeonyPetal,
    free: Sequence[str],
    points: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, "3"],
    unit: float,
) -> Placed:
    """The petal with the amplitudes and the tilt that explain the points."""
    above = _Above.of(petal, free, (points[:_FEW] - origin) @ rotation / unit)
    *rise, level, a, b = above.amplitudes
    # The plane z = level + a x + b y is the petal's own.
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    along = np.array([0.0, 1.0, b])
    along /= np.linalg.norm(along)
    tilt = np.stack([np.cross(along, normal), along, normal], axis=-1)
    petal = with_values(petal, dict(zip(above.names, rise, strict=True)))
    place = origin + unit * rotation @ np.array([0.0, 0.0, level])
    return Placed(petal, rotation @ tilt, place, unit, unit * above.misfit)


def _outlines(
    template: PeonyPetal, free: Sequence[str], xy: Float[np.ndarray, "n 2"]
) -> list[_Flat]:
    """Outlines that may fit the points, at different angles, the likeliest first."""
    far = np.asarray(KDTree(xy).query(xy, 9)[0])[:, -1]
    dense = xy[far <= _SPARSE * np.median(far)]
    # The farthest few of the points may be outliers.
    target = np.sort(dense @ _RAYS.T, axis=0)[-(1 + len(dense) // 128)]
    tolerance = _TOLERANCE * float(np.max(np.abs(target)))
    search = OutlineSearch.of(template, free)
    values, _ = search.around(search.middle, 1.0, _SPREAD)
    support = _support(search.edges(values), np.zeros(len(values)))
    turned = np.arange(_DIRECTIONS) - (_DIRECTIONS // _ROLLS) * np.arange(_ROLLS)[:, None]
    scores, shifts = _scores(support[:, turned], target, tolerance)
    best_roll = np.argmin(scores, axis=0)  # the best outline of every roll
    chosen: list[_Flat] = []
    for roll in np.argsort(scores[best_roll, np.arange(_ROLLS)]):
        k, angle = best_roll[roll], 2 * np.pi * float(roll) / _ROLLS
        if all(_between(angle, other.angle) > _APART for other in chosen):
            chosen.append(_Flat(values[k], angle, shifts[k, roll], float(scores[k, roll])))
        if len(chosen) == _REFINED:
            break
    refined = [_refined(search, flat, target, tolerance) for flat in chosen]
    return sorted(refined, key=lambda flat: flat.score)


def _between(one: float, other: float) -> float:
    return float(np.abs(np.angle(np.exp(1j * (one - other)))))


def _refined(
    search: OutlineSearch,
    flat: _Flat,
    target: Float[np.ndarray, " d"],
    tolerance: float,
) -> _Flat:
    """The best outline and angle from some generations around given ones."""
    reach = np.pi / _ROLLS
    for k in range(_GENERATIONS):
        values, extra = search.around(flat.values, 0.4 ** (k + 1), 1, 1)
        angles = flat.angle + 2 * reach * 0.5**k * (extra[:, 0] - 0.5)
        scores, shifts = _scores(_support(search.edges(values), angles), target, tolerance)
        best = int(np.argmin(scores))
        if scores[best] < flat.score:
            flat = _Flat(values[best], float(angles[best]), shifts[best], float(scores[best]))
    return flat


def _support(
    edges: Float[np.ndarray, "k m 2"], angles: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k d"]:
    """The support functions of outlines turned by angles: how far they reach along the rays."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    rays = np.stack(
        [cosine * _RAYS[:, 0] + sine * _RAYS[:, 1], cosine * _RAYS[:, 1] - sine * _RAYS[:, 0]],
        axis=1,
    )
    return np.max(edges @ rays, axis=1)


def _scores(
    support: Float[np.ndarray, "*k d"], target: Float[np.ndarray, " d"], tolerance: float
) -> tuple[Float[np.ndarray, "*k"], Float[np.ndarray, "*k 2"]]:
    """Misfits of outlines to a support function, each shifted to where it fits best, and the shifts."""
    gap = (target - support) / tolerance
    shift = np.zeros((*support.shape[:-1], 2))
    products = np.einsum("di,dj->dij", _RAYS, _RAYS).reshape(-1, 4)
    left = gap
    for _ in range(_SHIFTS):
        square = left**2
        weights = np.where(left > 0, _OUTSIDE / (1 + _SOFT * square), 1 / (1 + square))
        matrix = (weights @ products).reshape(*shift.shape[:-1], 2, 2)
        right = (weights * gap) @ _RAYS
        determinant = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] ** 2
        shift = (
            np.stack(
                [
                    matrix[..., 1, 1] * right[..., 0] - matrix[..., 0, 1] * right[..., 1],
                    matrix[..., 0, 0] * right[..., 1] - matrix[..., 0, 1] * right[..., 0],
                ],
                axis=-1,
            )
            / determinant[..., None]
        )
        left = gap - shift @ _RAYS.T
    square = left**2
    cost = np.where(left > 0, _OUTSIDE / _SOFT * np.log1p(_SOFT * square), np.log1p(square))
    return np.mean(cost, axis=-1), tolerance * shift
