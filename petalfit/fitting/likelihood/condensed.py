"""A large cloud, condensed to as many points as its likelihood near a surface depends on.

Twenty smooth numbers do not need millions of points in every step. The points are sorted into cells of
the surface that they lie near, small beside every bend of it, and near the edges into narrow bands along
them. The points of a cell count as one, at the mean of their places and of their distances from the
surface, with the sum of their weights: to first order in the change of the surface the likelihood is
that of all points.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from petalfit.compilation import blocks
from petalfit.fitting.coordinates import Box
from petalfit.fitting.likelihood import programs
from petalfit.fitting.likelihood.emptiness import Emptiness
from petalfit.fitting.likelihood.sheet import NUISANCES, Sheet, SheetCost
from petalfit.surfaces import AbstractSurface

ENOUGH = 4096  # points of a cloud that is not condensed
_NODES = (257, 193)  # of the grid on which foot points are looked up
# Bands along an edge: how far they reach inside and outside, and from where on they widen, in units of
# the blur.
_INSIDE, _OUTSIDE, _WIDENING = 8.0, 16.0, 6.0
_AT_ONCE = 1 << 16  # points that are worked on at once
_LAST = np.array(_NODES) - 1
_REACH = 1.5  # how far a foot point may lie from its node, in steps of the grid
_WALKS, _FAR = 4, 0.8  # searches from nearer nodes, for foot points that lie farther than this
_STEPS = 3  # of Gauss and Newton
_TINY = 1e-300
Result = TypeVar("Result")


class Located(NamedTuple):
    """Where points lie beside a surface.

    Attributes:
        uv: Their foot points, inside the domain, shape (n, 2).
        place: The foot points in space, shape (n, 3).
        distance: Signed distances along the normal there, shape (n,).
        beyond: How far they lie beyond the edges of u and of v, negative inside, shape (n, 2).
    """

    uv: Float[np.ndarray, "n 2"]
    place: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    beyond: Float[np.ndarray, "n 2"]


@dataclasses.dataclass(frozen=True, eq=False)
class Relief:
    """A surface, sampled so finely that a quadric follows it around every node.

    The nodes are evenly spaced in u and in w, where v runs from one end to the other as (1 − cos πw)/2:
    at the ends of a blade the width may be any power of v.

    Attributes:
        tree: The nodes in space.
        patches: The quadric (S, S_u, S_w, S_uu, S_uw, S_ww) of every node, by steps of the grid, shape
            (m, 6, 3).
        domain: The lower and upper ends of u and v, shape (2, 2).
    """

    tree: KDTree
    patches: Float[np.ndarray, "m 6 3"]
    domain: Float[np.ndarray, "2 2"]

    @classmethod
    def of(cls, surface: AbstractSurface) -> Relief:
        """Samples a surface. Call it inside `jax.enable_x64(True)`."""
        domain = np.array(surface.domain, float)
        index = np.stack(np.meshgrid(*map(np.arange, _NODES), indexing="ij"), axis=-1)
        uv = _place(index.reshape(-1, 2).astype(float), domain)
        calls = [(surface, part) for part in blocks(uv)]
        found = [np.asarray(part) for part in programs.places.map(calls)]
        grid = np.concatenate(found)[: len(uv)].reshape(*_NODES, 3)
        by_u, by_w = _slope(grid, 0), _slope(grid, 1)
        patches = [grid, by_u, by_w, _slope(by_u, 0), _slope(by_u, 1), _slope(by_w, 1)]
        tree = KDTree(grid.reshape(-1, 3), balanced_tree=False, compact_nodes=False)
        return cls(tree, np.stack(patches, axis=2).reshape(-1, 6, 3), domain)

    def at(self, uv: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 3"]:
        """Places on the surface."""
        low, high = self.domain.T
        share = np.clip((uv - low) / (high - low), 0.0, 1.0)
        share[:, 1] = np.arccos(1 - 2 * share[:, 1]) / np.pi
        index = share * _LAST
        node = np.rint(index).astype(int)
        return _at(self._patches(node), index - node)

    def _patches(self, node: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "6 n 3"]:
        return np.moveaxis(self.patches[np.ravel_multi_index(tuple(node.T), _NODES)], 1, 0)

    def _moves(
        self, points: Float[np.ndarray, "n 3"], node: Int[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n 2"]:
        """The foot points on the quadrics of nodes, relative to them."""
        patch, move = self._patches(node), np.zeros((len(points), 2))
        low, high = np.maximum(-_REACH, -node), np.minimum(_REACH, _LAST - node)
        for _ in range(_STEPS):
            a, b = _tangents(patch, move)
            move = move + _step(a, b, points - _at(patch, move), low - move, high - move)
        return move

    def located(self, points: Float[np.ndarray, "n 3"]) -> Located:
        """Looks up the foot points of points."""
        node = np.stack(np.unravel_index(self.tree.query(points)[1], _NODES), axis=-1)
        move = self._moves(points, node)
        for _ in range(_WALKS):
            astray = np.flatnonzero(np.any(np.abs(move) > _FAR, axis=1))
            if not len(astray):
                break
            node[astray] += np.rint(move[astray]).astype(int)
            move[astray] = self._moves(points[astray], node[astray])
        patch, index = self._patches(node), node + move
        a, b = _tangents(patch, move)
        place = _at(patch, move)
        off, cross = points - place, np.cross(a, b)
        element = np.linalg.norm(cross, axis=1) + _TINY
        long = np.stack([np.linalg.norm(b, axis=1), np.linalg.norm(a, axis=1)], axis=-1) + _TINY
        uv, wide = _place(index, self.domain), self.domain[:, 1] - self.domain[:, 0]
        # Inside, the distance from the nearer edge along the surface; at an edge, the rest across it.
        turn = np.pi * index[:, 1] / _LAST[1]
        rate = np.stack([np.ones(len(turn)), 0.5 * np.pi * np.sin(turn)], axis=-1) / _LAST
        share = (uv - self.domain[:, 0]) / wide
        inside = np.minimum(share, 1 - share) / (rate + _TINY) * element[:, None] / long
        normal = cross / element[:, None]
        out = np.stack([np.cross(b, normal), np.cross(normal, a)], axis=1) / long[..., None]
        rest = np.einsum("nki,ni->nk", out, off)
        beyond = np.where(share < 0.5, -rest, rest) - inside
        return Located(uv, place, _dot(off, normal), beyond)


@dataclasses.dataclass(frozen=True)
class Cells:
    """The cells that the points of a cloud are sorted into.

    Attributes:
        across: The number of cells across the surface, far from its edges.
        along: The same along the surface.
        band: The width of the bands along an edge, in units of the blur.
    """

    across: int
    along: int
    band: float

    @property
    def bands(self) -> int:
        """The number of bands at each edge."""
        return math.ceil((_INSIDE + _OUTSIDE) / self.band)

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and columns, with the bands at both ends."""
        return self.across + 2 * self.bands, self.along + 2 * self.bands

    def numbers(self, relief: Relief, near: Located, blur: float) -> Int[np.ndarray, " n"]:
        """The number of the cell of each point."""
        low, high = relief.domain.T
        shares, beyond = (near.uv - low) / (high - low), near.beyond / blur
        # Far beyond an edge bands widen, as logarithms do.
        wide = _WIDENING * (1 + np.log(np.maximum(beyond, _WIDENING) / _WIDENING))
        band = (np.where(beyond > _WIDENING, wide, beyond) + _INSIDE) / self.band
        band = np.clip(band, 0, self.bands - 1).astype(int)
        counts = np.array([self.across, self.along])
        edge = counts + np.where(shares < 0.5, 0, self.bands) + band
        inside = np.clip(shares * counts, 0, counts - 1).astype(int)
        found = np.where(beyond < -_INSIDE, inside, edge)
        return np.asarray(np.ravel_multi_index(tuple(found.T), self.shape))


FINE, COARSE = Cells(96, 128, 0.125), Cells(24, 32, 0.5)


@dataclasses.dataclass(frozen=True, eq=False)
class CondensedSheet(Sheet):
    """The likelihood of a large cloud near a surface: one point for each cell.

    Attributes:
        cloud: The likelihood of the cloud itself.
        scattered: Σ w |x − x̄|² of its points about those that stand for them.
        uv: The places of the cells on the surface, shape (n, 2).
    """

    cloud: Sheet
    scattered: float
    uv: Float[np.ndarray, "n 2"]

    @classmethod
    def of(
        cls, cloud: Sheet, surface: AbstractSurface, blur: float, cells: Cells
    ) -> CondensedSheet:
        """Condenses a cloud near a surface.

        Args:
            cloud: The likelihood of the cloud.
            surface: The surface, which lies nearly where the cloud does.
            blur: The blur τ of its edges.
            cells: The size of the cells.
        """
        relief = Relief.of(surface)

        def sums_over(parts: Sequence[slice]) -> Float[np.ndarray, "m 7"]:
            sums = np.zeros((math.prod(cells.shape), 7))
            for part in parts:
                points = cloud.points[part]
                near = relief.located(points)
                number, off = cells.numbers(relief, near, blur), points - near.place
                columns = [near.uv, off, _dot(off, off)]
                for k, column in enumerate(np.column_stack([np.ones(len(points)), *columns]).T):
                    sums[:, k] += np.bincount(number, cloud.weights[part] * column, len(sums))
            return sums

        sums = np.sum(_on_all_cores(sums_over, len(cloud.points)), axis=0)
        sums = sums[sums[:, 0] > 0]
        weights = sums[:, 0]
        uv, off, square = np.split(sums[:, 1:] / weights[:, None], [2, 5], axis=1)
        # The mean of places on a bent surface lies beside it; the mean distance is that from the surface.
        points = relief.at(uv) + off
        scattered = float(weights @ (square[:, 0] - _dot(off, off)))
        return cls(points, weights, cloud, max(scattered, 0.0), uv)

    @property
    def whole(self) -> Sheet:
        return self.cloud

    def cost(
        self,
        box: Box,
        z: Float[np.ndarray, " q"],
        places: Float[np.ndarray, "m 2"],
        steps: int,
    ) -> SheetCost:
        found = super().cost(box, z, places, steps)
        lost = self.scattered * float(np.exp(-2 * z[-NUISANCES]))
        found.gradient[-NUISANCES] -= lost
        found.information[-NUISANCES, -NUISANCES] += 2 * lost
        return found._replace(cost=found.cost + 0.5 * lost)

    def nearest(self, surface: AbstractSurface) -> Float[np.ndarray, "m 2"]:
        """The places of the cells; every surface that is asked for is near to the one that has them."""
        return np.concatenate(blocks(self.uv))

    def beside(
        self, surface: AbstractSurface, places: Float[np.ndarray, "m 2"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """The same for all points of the cloud, which are looked up anew."""
        return beside_many(surface, self.cloud.points)

    @cached_property
    def _emptiness(self) -> Emptiness:
        return self.cloud._emptiness


def beside_many(
    surface: AbstractSurface, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Signed normal distances of many points, distances beyond the edge, and foot points inside it."""
    relief, size = Relief.of(surface), len(points)
    distance, beyond, uv = np.empty(size), np.empty(size), np.empty((size, 2))

    def fill(parts: Sequence[slice]) -> None:
        for part in parts:
            near = relief.located(points[part])
            distance[part], uv[part] = near.distance, near.uv
            beyond[part] = np.max(near.beyond, axis=1)

    _on_all_cores(fill, size)
    return distance, beyond, uv


def _on_all_cores(work: Callable[[Sequence[slice]], Result], size: int) -> list[Result]:
    """What a function returns for each of several shares of the parts of many rows."""
    parts = [slice(first, first + _AT_ONCE) for first in range(0, size, _AT_ONCE)]
    cores = min(os.cpu_count() or 1, len(parts))
    with ThreadPoolExecutor(cores) as pool:
        return list(pool.map(work, [parts[core::cores] for core in range(cores)]))


def _place(
    index: Float[np.ndarray, "n 2"], domain: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "n 2"]:
    """(u, v) at indices of the grid, whole ones and between them."""
    share = index / _LAST
    share[:, 1] = 0.5 - 0.5 * np.cos(np.pi * share[:, 1])
    return domain[:, 0] + (domain[:, 1] - domain[:, 0]) * share


def _step(
    a: Float[np.ndarray, "n 3"],
    b: Float[np.ndarray, "n 3"],
    left: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "n 2"],
    high: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 2"]:
    """The combinations of a and b, inside a box, that come nearest to `left`."""
    aa, ab, bb = _dot(a, a) + _TINY, _dot(a, b), _dot(b, b) + _TINY
    ga, gb = _dot(a, left), _dot(b, left)
    whole = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb)
    u, v = (bb * ga - ab * gb) / whole, (aa * gb - ab * ga) / whole
    u, v = np.clip(u, low[:, 0], high[:, 0]), np.clip(v, low[:, 1], high[:, 1])
    for _ in range(2):
        u = np.clip((ga - ab * v) / aa, low[:, 0], high[:, 0])
        v = np.clip((gb - ab * u) / bb, low[:, 1], high[:, 1])
    return np.stack([u, v], axis=-1)


def _slope(grid: Float[np.ndarray, "n_u n_v 3"], axis: int) -> Float[np.ndarray, "n_u n_v 3"]:
    """Differences by the steps of an axis, of the fourth order but for its two outer nodes."""
    rows = np.moveaxis(grid, axis, 0)
    slope = np.gradient(rows, axis=0, edge_order=2)
    slope[2:-2] = (8 * (rows[3:-1] - rows[1:-3]) - (rows[4:] - rows[:-4])) / 12
    return np.moveaxis(slope, 0, axis)


def _at(
    patch: Float[np.ndarray, "6 n 3"], move: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    du, dv = move[:, :1], move[:, 1:]
    here, by_u, by_v, by_uu, by_uv, by_vv = patch
    return here + du * (by_u + 0.5 * du * by_uu + dv * by_uv) + dv * (by_v + 0.5 * dv * by_vv)


def _tangents(
    patch: Float[np.ndarray, "6 n 3"], move: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    du, dv = move[:, :1], move[:, 1:]
    _, by_u, by_v, by_uu, by_uv, by_vv = patch
    return by_u + du * by_uu + dv * by_uv, by_v + du * by_uv + dv * by_vv


def _dot(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.einsum("ni,ni->n", a, b)
