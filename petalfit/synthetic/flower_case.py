"""A synthetic case of a whole flower: it is grown, scanned, and the petal of every point is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from petalfit.flowers import Flower, grow, lily, peony
from petalfit.observations import PointCloud
from petalfit.surfaces import grid_faces
from petalfit.synthetic.case import DECIMALS

KINDS: dict[str, Callable[[int], Flower]] = {
    "lily": lily,
    "small peony": lambda seed: peony(seed, petals=15),
}
_DENSE = 30  # points that hide others, by those that are kept
# Cosine of the angle between a surface's normal and the view below which a scanner sees nothing.
_STEEP = 0.25
_FINE = 1.5  # side of a pixel of a view, in mean distances of the points that hide others
_FINER = 3  # the grids of surfaces, by those of a flower's files
_TABLE = 0.7  # side of the table, by the larger breadth of the flower

NONE = -1  # the label of a point on another organ, or on the table


@dataclasses.dataclass(frozen=True)
class FlowerCase:
    """The recipe of a flower that is scanned.

    Attributes:
        name: The name of the case and of its folder.
        about: One line on the difficulty of the case.
        kind: The kind of flower, a key of `KINDS`.
        points: The number of points.
        noise: The standard deviation σ of every coordinate, in the unit of length.
        seed: The seed of the flower, of the points and of the noise.
        views: The directions towards the scanners, which are far away; y points up.
        table: Whether the flower stands on a table, whose points are among those of the cloud.
        turn: The rotation of the cloud: a vector, by its length in rad.
    """

    name: str
    about: str
    kind: str
    points: int
    noise: float
    seed: int
    views: tuple[tuple[float, float, float], ...]
    table: bool = False
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def flower(self) -> Flower:
        """The flower, in its own frame."""
        return KINDS[self.kind](self.seed)


class Scan(NamedTuple):
    """A scanned flower.

    Attributes:
        cloud: The points, without normals, in the pose of the case.
        labels: The number of the petal that each point lies on, `NONE` for other organs and the table.
    """

    cloud: PointCloud
    labels: Int[np.ndarray, " n"]


class _Points(NamedTuple):
    """Points of surfaces, with normals and the petals that they belong to."""

    places: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    labels: Int[np.ndarray, " n"]


def scan(case: FlowerCase) -> Scan:
    """The points of a case that at least one scanner sees, uniform by area, with noise.

    Args:
        case: The recipe.

    Returns:
        The cloud, rounded like those of other cases, and the petals of its points.
    """
    surface, count = _Triangles.of(case), 4 * case.points
    rng = np.random.default_rng([case.seed, 4])
    hiding = surface.sample(_DENSE * case.points, rng).places
    while True:
        drawn = surface.sample(count, rng)
        seen = np.zeros(count, bool)
        for view in case.views:
            seen |= _seen(drawn, hiding, np.array(view) / np.linalg.norm(view))
        some = np.flatnonzero(seen)
        if len(some) >= case.points:
            break
        count *= 2
    some = some[: case.points]
    noise = case.noise * rng.standard_normal((case.points, 3))
    places = (drawn.places[some] + noise) @ Rotation.from_rotvec(case.turn).as_matrix().T
    return Scan(PointCloud(np.round(places, DECIMALS)), drawn.labels[some])


class _Triangles(NamedTuple):
    """The surface of a flower and its table: corners (m, 3, 3) of triangles, and the petal of each."""

    corners: Float[np.ndarray, "m 3 3"]
    labels: Int[np.ndarray, " m"]

    @classmethod
    def of(cls, case: FlowerCase) -> _Triangles:
        flower = case.flower()
        corners, labels = [], []
        for grown in grow(flower, _FINER):
            part, vertices = grown.part, np.round(grown.in_flower().vertices, DECIMALS)
            is_petal = part.series >= 0 and flower.series[part.series].name == "petal"
            for number, grid in enumerate(vertices):
                corners.append(grid.reshape(-1, 3)[grid_faces(grid.shape[:2], 1.0)])
                labels.append(np.full(len(corners[-1]), number if is_petal else NONE))
        if case.table:
            corners.append(_table(np.concatenate(corners).reshape(-1, 3)))
            labels.append(np.full(len(corners[-1]), NONE))
        return cls(np.concatenate(corners), np.concatenate(labels))

    def sample(self, count: int, rng: np.random.Generator) -> _Points:
        """Random points, uniform by area."""
        first, *others = np.moveaxis(self.corners, 1, 0)
        across = np.cross(*(other - first for other in others))
        twice = np.linalg.norm(across, axis=-1)
        upto = np.cumsum(twice)
        which = np.searchsorted(upto, upto[-1] * rng.random(count))
        one, other = rng.random((2, count))
        over = one + other > 1
        shares = np.where(over, 1 - one, one), np.where(over, 1 - other, other)
        places = first[which]
        for share, corner in zip(shares, others, strict=True):
            places = places + share[:, None] * (corner - first)[which]
        return _Points(places, across[which] / twice[which, None], self.labels[which])


def _table(every: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3 3"]:
    """A square below all points of a flower, as two triangles."""
    low, high = every.min(axis=0), every.max(axis=0)
    middle = 0.5 * (low + high)
    half = 0.5 * _TABLE * max(high[0] - low[0], high[2] - low[2])
    x, z = middle[0] + half * np.array([-1, -1, 1, 1]), middle[2] + half * np.array([-1, 1, 1, -1])
    square = np.column_stack([x, np.full(4, low[1]), z])
    return square[[[0, 1, 2], [0, 2, 3]]]


def _seen(
    drawn: _Points, hiding: Float[np.ndarray, "m 3"], towards: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, " n"]:
    """Whether a scanner in a direction sees each point: nothing hides it, and it is not seen edge-on."""
    across = np.linalg.svd(towards[None])[2][1:]
    flat, depth = hiding @ across.T, hiding @ towards
    low, size = flat.min(axis=0), np.ptp(flat, axis=0)
    side = _FINE * float(np.sqrt(np.prod(size) / len(hiding)))
    shape = np.ceil(size / side).astype(int) + 1
    nearest = np.full(shape, -np.inf)
    column, row = ((flat - low) / side).astype(int).T
    np.maximum.at(nearest, (column, row), depth)
    column, row = np.clip(((drawn.places @ across.T - low) / side).astype(int), 0, shape - 1).T
    behind = nearest[column, row] - drawn.places @ towards
    return (behind < side / _STEEP) & (np.abs(drawn.normals @ towards) > _STEEP)
