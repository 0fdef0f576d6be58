"""A surface, sampled so finely that foot points of many points are looked up rather than searched for."""

from __future__ import annotations

import contextvars
import dataclasses
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from petalfit.compilation import Program, pad_to
from petalfit.compilation.stopwatch import unwatched
from petalfit.fitting.coordinates import Numbers
from petalfit.fitting.likelihood.foot_points import whole_distance
from petalfit.residuals import places
from petalfit.surfaces import AbstractSurface

_NODES = (257, 193)  # of the grid on which foot points are looked up
_AT_ONCE = 1 << 15  # points that are worked on at once
_LAST = np.array(_NODES) - 1
_REACH = 1.5  # how far a foot point may lie from its node, in steps of the grid
_WALKS, _FAR = 4, 0.8  # searches from nearer nodes, for foot points that lie farther than this
_STEPS = 3  # of Gauss and Newton
_TINY = 1e-300
Result = TypeVar("Result")
Rows = Array | np.ndarray


class Located(NamedTuple):
    """Where points lie beside a surface.

    Attributes:
        uv: Their foot points, inside the domain, shape (n, 2).
        place: The foot points in space, shape (n, 3).
        normal: The unit normals there, shape (n, 3).
        distance: Signed distances along the normals, shape (n,).
        beyond: How far they lie beyond the edges of u and of v, negative inside, shape (n, 2).
    """

    uv: Float[Rows, "n 2"]
    place: Float[Rows, "n 3"]
    normal: Float[Rows, "n 3"]
    distance: Float[Rows, " n"]
    beyond: Float[Rows, "n 2"]


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
        orientation: 1, or -1 where normals are turned, see `AbstractSurface`.
    """

    tree: KDTree
    patches: Float[np.ndarray, "m 6 3"]
    domain: Float[np.ndarray, "2 2"]
    orientation: float

    @classmethod
    def of(cls, surface: AbstractSurface) -> Relief:
        """Samples a surface. Call it inside `jax.enable_x64(True)`."""
        domain = np.array(surface.domain, float)
        index = np.stack(np.meshgrid(*map(np.arange, _NODES), indexing="ij"), axis=-1)
        uv = _place(index.reshape(-1, 2).astype(float), domain)
        grid = places(surface, uv).reshape(*_NODES, 3)
        by_u, by_w = _slope(grid, 0), _slope(grid, 1)
        patches = [grid, by_u, by_w, _slope(by_u, 0), _slope(by_u, 1), _slope(by_w, 1)]
        tree = KDTree(grid.reshape(-1, 3), balanced_tree=False, compact_nodes=False)
        fine = np.stack(patches, axis=2).reshape(-1, 6, 3)
        return cls(tree, fine, domain, float(surface.orientation))

    def at(
        self, uv: Float[np.ndarray, "k 2"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Places on the surface, and unit normals there."""
        low, high = self.domain.T
        share = np.clip((uv - low) / (high - low), 0.0, 1.0)
        share[:, 1] = np.arccos(1 - 2 * share[:, 1]) / np.pi
        index = share * _LAST
        node = np.rint(index).astype(int)
        patch, move = self._patches(node), index - node
        cross = self.orientation * np.cross(*_tangents(patch, move))
        return _at(patch, move), cross / (np.linalg.norm(cross, axis=1, keepdims=True) + _TINY)

    def _patches(self, node: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "6 n 3"]:
        return np.moveaxis(self.patches[np.ravel_multi_index(tuple(node.T), _NODES)], 1, 0)

    def located(self, points: Float[np.ndarray, "n 3"]) -> Located:
        """Looks up the foot points of points; so many at once that one program serves all calls."""
        nodes, size = self.tree.query(points)[1], len(points)
        rows = pad_to(points, _AT_ONCE), pad_to(nodes, _AT_ONCE)
        found = _locate(self.patches, self.domain, self.orientation, *rows)
        return Located(*(np.asarray(x)[:size] for x in found))


def _located(
    patches: Float[Array, "m 6 3"],
    domain: Float[Array, "2 2"],
    orientation: Float[Array, ""],
    points: Float[Array, "n 3"],
    nodes: Int[Array, " n"],
) -> Located:
    """The foot points of points on the quadrics around the nodes, which are nearest to them."""

    def patches_at(node: Array) -> Array:
        return jnp.moveaxis(patches[node[:, 0] * _NODES[1] + node[:, 1]], 1, 0)

    def moves(node: Array) -> Array:
        patch = patches_at(node)
        low, high = jnp.maximum(-_REACH, -node), jnp.minimum(_REACH, _LAST - node)

        def step(_: Array, move: Array) -> Array:
            tangents = _tangents(patch, move)
            return move + _step(*tangents, points - _at(patch, move), low - move, high - move)

        return jax.lax.fori_loop(0, _STEPS, step, jnp.zeros((len(points), 2)))

    def astray(state: tuple) -> Array:
        walks, _, move = state
        return (walks < _WALKS) & jnp.any(jnp.abs(move) > _FAR)

    def walk(state: tuple) -> tuple:
        walks, node, move = state
        away = jnp.any(jnp.abs(move) > _FAR, axis=1, keepdims=True)
        node = node + jnp.where(away, jnp.rint(move).astype(node.dtype), 0)
        return walks + 1, node, moves(node)

    start = jnp.stack(jnp.divmod(nodes, _NODES[1]), axis=-1)
    _, node, move = jax.lax.while_loop(astray, walk, (0, start, moves(start)))
    patch, index = patches_at(node), node + move
    a, b = _tangents(patch, move)
    place = _at(patch, move)
    off, cross = points - place, jnp.cross(a, b)
    element = _length(cross)
    long = jnp.stack([_length(b), _length(a)], axis=-1)
    low, wide = domain[:, 0], domain[:, 1] - domain[:, 0]
    half = 0.5 * jnp.pi * index[:, 1] / _LAST[1]
    share = jnp.stack([index[:, 0] / _LAST[0], jnp.sin(half) ** 2], axis=-1)
    # Inside, the distance from the nearer edge along the surface; at an edge, the rest across it.
    rate = jnp.stack([jnp.ones(len(half)), 0.5 * jnp.pi * jnp.sin(2 * half)], axis=-1) / _LAST
    inside = jnp.minimum(share, 1 - share) / (rate + _TINY) * element[:, None] / long
    normal = cross / element[:, None]
    out = jnp.stack([jnp.cross(b, normal), jnp.cross(normal, a)], axis=1) / long[..., None]
    rest = jnp.einsum("nki,ni->nk", out, off)
    beyond = jnp.where(share < 0.5, -rest, rest) - inside
    normal = orientation * normal
    return Located(low + wide * share, place, normal, jnp.sum(off * normal, axis=-1), beyond)


_locate = Program(_located)


def beside_many(
    surface: AbstractSurface, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Signed distances of many points, distances beyond the edge, and foot points inside it.

    Some points may be too far away for the quadrics, so these distances are those of `whole_distance`.
    """
    relief, size = Relief.of(surface), len(points)
    distance, beyond, uv = np.empty(size), np.empty(size), np.empty((size, 2))

    def fill(parts: Sequence[slice]) -> None:
        for part in parts:
            near = relief.located(points[part])
            whole = whole_distance(points[part] - near.place, near.distance, near.beyond)
            distance[part], uv[part] = np.copysign(whole, near.distance), near.uv
            beyond[part] = np.max(near.beyond, axis=1)

    on_all_cores(fill, size)
    return distance, beyond, uv


def on_all_cores(work: Callable[[Sequence[slice]], Result], size: int) -> list[Result]:
    """What a function returns for each of several shares of the parts of many rows."""
    parts = [slice(first, first + _AT_ONCE) for first in range(0, size, _AT_ONCE)]
    cores = min(os.cpu_count() or 1, len(parts))

    def beside(share: Sequence[slice]) -> Result:
        # Settings of jax belong to a thread.
        with unwatched(), jax.enable_x64(True):
            return work(share)

    with ThreadPoolExecutor(cores) as pool:
        found = [
            pool.submit(contextvars.copy_context().run, beside, parts[core::cores])
            for core in range(cores)
        ]
        return [future.result() for future in found]


def _place(
    index: Float[np.ndarray, "n 2"], domain: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "n 2"]:
    """(u, v) at indices of the grid, whole ones and between them."""
    share = index / _LAST
    share[:, 1] = 0.5 - 0.5 * np.cos(np.pi * share[:, 1])
    return domain[:, 0] + (domain[:, 1] - domain[:, 0]) * share


def _step(a: Array, b: Array, left: Array, low: Array, high: Array) -> Array:
    """The combinations of a and b, inside a box, that come nearest to `left`, shape (n, 2)."""
    aa, ab, bb = (jnp.sum(x * y, axis=-1) for x, y in ((a, a), (a, b), (b, b)))
    aa, bb = aa + _TINY, bb + _TINY
    ga, gb = jnp.sum(a * left, axis=-1), jnp.sum(b * left, axis=-1)
    whole = jnp.maximum(aa * bb - ab**2, 1e-12 * aa * bb)
    u, v = (bb * ga - ab * gb) / whole, (aa * gb - ab * ga) / whole
    u, v = jnp.clip(u, low[:, 0], high[:, 0]), jnp.clip(v, low[:, 1], high[:, 1])
    for _ in range(2):
        u = jnp.clip((ga - ab * v) / aa, low[:, 0], high[:, 0])
        v = jnp.clip((gb - ab * u) / bb, low[:, 1], high[:, 1])
    return jnp.stack([u, v], axis=-1)


def _length(x: Array) -> Array:
    return jnp.linalg.norm(x, axis=-1) + _TINY


def _slope(grid: Float[np.ndarray, "n_u n_v 3"], axis: int) -> Float[np.ndarray, "n_u n_v 3"]:
    """Differences by the steps of an axis, of the fourth order but for its two outer nodes."""
    rows = np.moveaxis(grid, axis, 0)
    slope = np.gradient(rows, axis=0, edge_order=2)
    slope[2:-2] = (8 * (rows[3:-1] - rows[1:-3]) - (rows[4:] - rows[:-4])) / 12
    return np.moveaxis(slope, 0, axis)


def _at(patch: Numbers, move: Numbers) -> Any:
    """Places on the quadrics of nodes, shape (n, 3), at (n, 2) moves from them in steps of the grid."""
    du, dv = move[:, :1], move[:, 1:]
    here, by_u, by_v, by_uu, by_uv, by_vv = patch
    return here + du * (by_u + 0.5 * du * by_uu + dv * by_uv) + dv * (by_v + 0.5 * dv * by_vv)


def _tangents(patch: Numbers, move: Numbers) -> tuple[Any, Any]:
    du, dv = move[:, :1], move[:, 1:]
    _, by_u, by_v, by_uu, by_uv, by_vv = patch
    return by_u + du * by_uu + dv * by_uv, by_v + du * by_uv + dv * by_vv


def dot(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The scalar product of each row of a with that of b."""
    return np.einsum("ni,ni->n", a, b)
