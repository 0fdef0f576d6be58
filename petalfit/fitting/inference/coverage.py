"""How much of a fitted surface has points near it, of its area and of its outline, and beyond it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label
from scipy.spatial import KDTree

from petalfit.fitting.likelihood.quadrature import SHAPE, Quadrature, around, normals_around
from petalfit.fitting.likelihood.scales import spacing
from petalfit.fitting.starts.flatten import flat_outline
from petalfit.surfaces import AbstractSurface

# A place has no points near it if the nearest one is farther than so many spacings, which of points that
# are spread evenly happens to one place in 10⁸.
_SPACINGS = 2.5
# Points go on beyond the outline if one lies so near, in spacings, to a place so far beyond it.
_BEYOND, _NEAR = 3.0, 1.25
# The outline is loose where the nearest point is farther than so many spacings. Of an outline that was
# drawn around points that are spread evenly, this is 3 %.
_LOOSE = 1.5
_DIRECTIONS = 720  # in which an outline's farthest point is found
_FEWEST = 50  # points, below which nothing can be said of their spacing
_MOST = 2000  # points that the nearest one is searched among: the verdict does not depend on their number


class Coverage(NamedTuple):
    """The parts of a surface that have no points near them, and those that the points go on beyond.

    Attributes:
        area: The part of its area, from 0 to 1.
        outline: The part of its outline; 0 if it is closed.
        scattered: The same without the two longest stretches, which may have been hidden or cut off.
        crossed: The part of its outline where the points go on beyond it, as at the seam of a sheet that
            is wrapped around a closed body.
        hole: The part of its area in holes, where no points are although there are some all around; 0 if
            it is closed.
        loose: The part of its outline that lies beside the points, as where it spans a bay of theirs.
        folded: The part of its area at which it turns back on itself between two nodes.
        bay: How deep its own outline goes in, when it is laid flat, as a part of its greatest length.
    """

    area: float
    outline: float
    scattered: float
    crossed: float
    hole: float
    loose: float
    folded: float
    bay: float

    @classmethod
    def of(cls, model: AbstractSurface, points: Float[np.ndarray, "n 3"]) -> Coverage | None:
        """The coverage of a surface by points; None if there are too few to tell.

        Args:
            model: The surface, in the frame of the points.
            points: The points that belong to it.
        """
        if len(points) < _FEWEST:
            return None
        if len(points) > _MOST:
            points = points[np.random.default_rng(0).permutation(len(points))[:_MOST]]
        nodes, tree = Quadrature.of(model), KDTree(points)
        grid = nodes.places.reshape(*SHAPE, 3)
        gap, side = np.asarray(tree.query(grid)[0]), spacing(tree)
        bare = gap > _SPACINGS * side
        shares = nodes.area / max(np.sum(nodes.area), 1e-300)
        area, folded = float(np.sum(shares[bare])), _folded(grid, shares)
        if not all(model.edges):
            return cls(area, 0.0, 0.0, 0.0, 0.0, 0.0, folded, 0.0)
        hole = float(np.sum(shares[bare & ~reached_from_the_edge(bare)]))
        rim = Rim.of(grid)
        stretches = sorted(rim.stretches(around(bare)))
        outline, scattered = sum(stretches), sum(stretches[:-2])
        away = np.asarray(tree.query(rim.places + _BEYOND * side * rim.conormals)[0])
        crossed = float(np.sum(rim.shares[away < _NEAR * side]))
        loose = float(np.sum(rim.shares[around(gap) > _LOOSE * side]))
        return cls(area, outline, scattered, crossed, hole, loose, folded, deepest_bay(grid))


class Rim(NamedTuple):
    """The outline of a surface, as a closed line of nodes.

    Attributes:
        places: The nodes, shape (m, 3).
        conormals: Unit vectors that point out of the surface, within it, shape (m, 3).
        shares: The part of the length that each node stands for, shape (m,).
    """

    places: Float[np.ndarray, "m 3"]
    conormals: Float[np.ndarray, "m 3"]
    shares: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, grid: Float[np.ndarray, "n_u n_v 3"]) -> Rim:
        """The outline of a grid of nodes on a surface."""
        inside = grid.copy()
        inside[:, 0], inside[:, -1] = grid[:, 1], grid[:, -2]
        inside[0], inside[-1] = grid[1], grid[-2]
        places = around(grid)
        before, after = np.roll(places, 1, axis=0), np.roll(places, -1, axis=0)
        along, out = _unit(after - before), places - around(inside)
        out = _unit(out - np.sum(out * along, axis=-1, keepdims=True) * along)
        steps = np.linalg.norm(places - before, axis=-1)
        length = max(float(np.sum(steps)), 1e-300)
        return cls(places, out, 0.5 * (steps + np.roll(steps, -1)) / length)

    def stretches(self, bare: Bool[np.ndarray, " m"]) -> list[float]:
        """Lengths of the stretches that are bare, as parts of the whole length."""
        if bare.all():
            return [1.0]
        # Begun at a node that is not bare, no stretch is cut in two.
        first = -int(np.argmin(bare))
        bare, shares = np.roll(bare, first), np.roll(self.shares, first)
        number = np.cumsum(np.diff(bare, prepend=False) & bare)[bare]
        return np.bincount(number, shares[bare])[1:].tolist() if bare.any() else []


def reached_from_the_edge(empty: Bool[np.ndarray, "m n"]) -> Bool[np.ndarray, "m n"]:
    """The empty nodes of a grid that others connect with its edge; the rest of them are in holes."""
    piece = np.zeros(empty.shape, int)
    count = int(label(empty, output=piece))  # pyright: ignore[reportArgumentType]
    edge = np.concatenate([piece[0], piece[-1], piece[:, 0], piece[:, -1]])
    reached = np.zeros(count + 1, bool)
    reached[edge] = True
    return empty & reached[piece]


def _folded(grid: Float[np.ndarray, "n_u n_v 3"], shares: Float[np.ndarray, "n_u n_v"]) -> float:
    """The part of the area between nodes where the normal turns by more than a right angle."""
    normal, folded = normals_around(grid), 0.0
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        turned = np.sum(normal[one] * normal[other], axis=-1) < 0
        folded += float(np.sum(np.minimum(shares[one], shares[other])[turned]))
    return folded


def deepest_bay(grid: Float[np.ndarray, "n_u n_v 3"]) -> float:
    """How deep an outline goes in between two of its points, as a part of its greatest length."""
    outline = flat_outline(grid[::2, ::2])  # which changes a depth by 0.01 at most
    angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    along = outline @ np.stack([np.cos(angle), np.sin(angle)])
    farthest = along.max(axis=0)
    length = float(np.max(farthest + np.roll(farthest, _DIRECTIONS // 2)))
    return float(np.max(np.min(farthest - along, axis=1))) / max(length, 1e-300)


def _unit(vectors: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
