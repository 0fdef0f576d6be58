"""The outline of a surface in the image of a camera: the rims and folds that bound its silhouette.

A rim is an edge of the domain; a fold is where the line of sight is tangent to the surface. A line of
sight meets the surface in a number of layers, here called sheets. Across a rim outwards this number
decreases by one, across a fold by two. A place on a rim or fold belongs to the outline if no sheet is
left just outside of it. Sheets are counted by winding numbers: the winding numbers of the triangles of a
mesh, each taken as positive, add up to those of its rims and folds alone, since all other edges cancel.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from petalfit.compilation import Program
from petalfit.observations import Camera
from petalfit.surfaces.map import AbstractMap, position_and_tangents
from petalfit.surfaces.programs import grid_positions

PLACES = 1536  # a fixed number, so that all outlines share one compiled program
_OUTSIDE = 1e-3  # pixels between an edge and the place just outside of it
_BAND = 64  # places, neighbours in y, whose sheets are counted at a time


class Edges(NamedTuple):
    """The edges on rims and folds of a mesh on a regular grid, projected into an image.

    Attributes:
        start: The vertices where the edges begin, as indices into the flattened grid, shape (k,).
        end: The vertices where they end, shape (k,). From start to end the surface lies on the left, in
            the sense in which x × y is positive.
        sheets: The number of sheets that end at each edge: 1 for a rim, 2 for a fold; shape (k,).
        along: The direction in (u, v) of a rim, or zero for a fold; shape (k, 2).
    """

    start: Int[np.ndarray, " k"]
    end: Int[np.ndarray, " k"]
    sheets: Int[np.ndarray, " k"]
    along: Float[np.ndarray, "k 2"]


class Outline(NamedTuple):
    """`PLACES` places on an outline, evenly spaced in the image.

    Attributes:
        uv: The places on the surface (u, v), shape (n, 2).
        place: The places in the image (x, y), in pixels, shape (n, 2).
        normal: Unit normals in the image, pointing away from the surface, shape (n, 2).
        length: The length of outline that each place stands for, in pixels, shape (n,).
    """

    uv: Float[np.ndarray, "n 2"]
    place: Float[np.ndarray, "n 2"]
    normal: Float[np.ndarray, "n 2"]
    length: Float[np.ndarray, " n"]


def outline(
    surface: AbstractMap, camera: Camera, resolution: tuple[int, int] = (97, 65)
) -> Outline:
    """The outline of a surface. Call it inside `jax.enable_x64(True)`.

    A mesh decides which rims and folds belong to the outline; its places then lie on those of the surface
    itself.

    Args:
        surface: Any surface in front of the camera.
        camera: The camera, in the surface's frame and unit.
        resolution: The numbers of vertices of the mesh along u and along v.
    """
    u, v = (np.linspace(*side, n) for side, n in zip(surface.domain, resolution, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        grid = camera.project(np.asarray(grid_positions(surface, u, v)))
    grid = np.nan_to_num(grid, posinf=1e9, neginf=-1e9)
    edges, xy = rims_and_folds(grid), grid.reshape(-1, 2)
    across = xy[edges.end] - xy[edges.start]
    length = np.hypot(*across.T)
    normal = np.stack([across[:, 1], -across[:, 0]], axis=-1) / np.maximum(length, 1e-12)[:, None]
    outside = 0.5 * (xy[edges.start] + xy[edges.end]) + _OUTSIDE * normal
    seen = (sheets(outside, xy, edges) <= 0) & (length > 1e-9)
    if not seen.any():  # the surface is seen edge-on, as a line, or lies behind the eye
        seen = edges.sheets == 1
        length = np.maximum(length, 1e-9)
    edges = Edges(*(field[seen] for field in edges))
    length, normal = length[seen], normal[seen]
    # Places are evenly spaced along all edges, one edge after the other.
    run = np.cumsum(length)
    along = (np.arange(PLACES) + 0.5) * run[-1] / PLACES
    which = np.searchsorted(run, along)
    share = 1.0 - (run[which] - along) / length[which]
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    start, end = uv[edges.start[which]], uv[edges.end[which]]
    uv = start + share[:, None] * (end - start)
    uv, place, found = (
        np.asarray(x) for x in _places(surface, camera.matrix, uv, edges.along[which])
    )
    sense = np.sum(found * normal[which], axis=-1)
    return Outline(
        uv,
        place,
        found * np.where(sense < 0, -1.0, 1.0)[:, None],
        np.full(PLACES, run[-1] / PLACES),
    )


def rims_and_folds(grid: Float[np.ndarray, "n m 2"]) -> Edges:
    """The rims and folds of a projected grid.

    A rim is an edge of one triangle, a fold one of two triangles that show different sides. Folds come
    first. Every cell is divided along its diagonal from the vertex (i, j) to (i + 1, j + 1).
    """
    number = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
    a, b, c = (x - grid[:-1, :-1] for x in (grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]))
    lower, upper = _cross(a, b) >= 0, _cross(b, c) >= 0
    # For each kind of edge: the lower and the upper vertex, for folds whether the two triangles show
    # different sides, and whether the surface lies on the left on the way from lower to upper vertex.
    folds = [
        (number[:-1, :-1], number[1:, 1:], lower != upper, upper),
        (number[:-1, 1:-1], number[1:, 1:-1], lower[:, 1:] != upper[:, :-1], lower[:, 1:]),
        (number[1:-1, :-1], number[1:-1, 1:], lower[:-1] != upper[1:], lower[:-1]),
    ]
    rims = [
        (number[:-1, 0], number[1:, 0], lower[:, 0], (1.0, 0.0)),
        (number[:-1, -1], number[1:, -1], ~upper[:, -1], (1.0, 0.0)),
        (number[0, :-1], number[0, 1:], ~upper[0], (0.0, 1.0)),
        (number[-1, :-1], number[-1, 1:], lower[-1], (0.0, 1.0)),
    ]
    pieces = [(x[kept], y[kept], left[kept], 2, (0.0, 0.0)) for x, y, kept, left in folds]
    pieces += [(x, y, left, 1, along) for x, y, left, along in rims]
    return Edges(
        np.concatenate([np.where(left, x, y) for x, y, left, *_ in pieces]),
        np.concatenate([np.where(left, y, x) for x, y, left, *_ in pieces]),
        np.concatenate([np.full(len(x), count) for x, *_, count, _ in pieces]),
        np.concatenate([np.tile(along, (len(x), 1)) for x, *_, along in pieces]),
    )


def sheets(
    places: Float[np.ndarray, "n 2"], xy: Float[np.ndarray, "m 2"], edges: Edges
) -> Int[np.ndarray, " n"]:
    """The number of sheets of the mesh at places of the image that do not lie on an edge."""
    (start_x, start_y), (end_x, end_y) = xy[edges.start].T, xy[edges.end].T
    count = np.where(end_y > start_y, 1.0, -1.0) * edges.sheets
    low, high = np.minimum(start_y, end_y), np.maximum(start_y, end_y)
    slope = (end_x - start_x) / np.where(end_y == start_y, 1.0, end_y - start_y)
    found = np.empty(len(places), int)
    order = np.argsort(places[:, 1])
    for first in range(0, len(order), _BAND):
        some = order[first : first + _BAND]
        x, y = places[some, :1], places[some, 1:]
        # Whether a ray from the place to the right meets the edge; few edges reach the band of places.
        near = np.flatnonzero((low <= y[-1]) & (y[0] < high))
        met = (low[near] <= y) & (y < high[near])
        met &= start_x[near] + (y - start_y[near]) * slope[near] > x
        found[some] = np.rint(met @ count[near])
    return found


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def image_and_tangents(
    surface: AbstractMap, matrix: Float[Array, "3 4"], uv: Float[Array, "n 2"]
) -> tuple[Float[Array, "n 2"], Float[Array, "2 n 2"]]:
    """Places in the image, and their derivatives by u and by v along a new first axis."""
    position, tangents = position_and_tangents(surface, uv[:, 0], uv[:, 1])
    seen, moved = position @ matrix[:, :3].T + matrix[:, 3], tangents @ matrix[:, :3].T
    place = seen[:, :2] / seen[:, 2:]
    return place, (moved[..., :2] - place * moved[..., 2:]) / seen[:, 2:]


def _outline_places(
    surface: AbstractMap,
    matrix: Float[Array, "3 4"],
    uv: Float[Array, "n 2"],
    along: Float[Array, "n 2"],
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"], Float[Array, "n 2"]]:
    """The places `uv` with those near folds moved onto them, their images, and normals of either sign."""
    low, high = (jnp.asarray(side, uv.dtype) for side in zip(*surface.domain, strict=True))

    def facing(uv: Array) -> Array:
        _, tangents = image_and_tangents(surface, matrix, uv)
        return tangents[0, :, 0] * tangents[1, :, 1] - tangents[0, :, 1] * tangents[1, :, 0]

    def newton(_: Array, uv: Array) -> Array:
        def by(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(facing, (uv,), (jnp.broadcast_to(direction, uv.shape),))

        value, slope = jax.vmap(by, out_axes=(None, 1))(jnp.eye(2, dtype=uv.dtype))
        step = -value[:, None] * slope / (jnp.sum(slope**2, axis=-1, keepdims=True) + 1e-300)
        step = jnp.clip(step, -_LEAP * (high - low), _LEAP * (high - low))
        return jnp.clip(uv + step, low, high)

    def moved(k: Array, uv: Array) -> Array:
        some = jax.lax.dynamic_slice_in_dim(uv, k * _CHUNK, _CHUNK)
        some = jax.lax.fori_loop(0, 3, newton, some)
        return jax.lax.dynamic_update_slice_in_dim(uv, some, k * _CHUNK, 0)

    on_fold: Bool[Array, "n 1"] = jnp.all(along == 0, axis=-1, keepdims=True)
    chunks = (jnp.count_nonzero(on_fold) + _CHUNK - 1) // _CHUNK
    near = jax.lax.fori_loop(0, chunks, moved, uv)
    uv = jnp.where(on_fold, near, uv)
    place, tangents = image_and_tangents(surface, matrix, uv)
    # On a fold the images of both tangents lie along it; the longer one gives the direction best.
    squares = jnp.sum(tangents**2, axis=-1)
    longer = jnp.where((squares[0] > squares[1])[:, None], tangents[0], tangents[1])
    rim = along[:, :1] * tangents[0] + along[:, 1:] * tangents[1]
    tangent = jnp.where(on_fold, longer, rim)
    tangent = tangent / (jnp.linalg.norm(tangent, axis=-1, keepdims=True) + 1e-300)
    return uv, place, jnp.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)


_CHUNK = 64  # places that are moved at a time; PLACES is a multiple of it
_LEAP = 0.02  # largest step towards a fold, as a fraction of the domain
_places = Program(_outline_places)
