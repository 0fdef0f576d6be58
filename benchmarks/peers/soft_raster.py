"""A soft rasteriser + Adam: a petal from one mask by a blurred, differentiable silhouette, in JAX.

The idea of SoftRas and of PyTorch3D's silhouette shader: a pixel's coverage is the sigmoid of its signed
distance to the projected mesh. They take the distance to every triangle and join the triangles by
1 − Π(1 − p), which swells the outline of a finely tessellated sheet. This one takes the distance to the
outline of the union instead: rims and folds of the projected mesh that have no triangle beyond them. A
straight edge is then unbiased; what stays is a bias at corners, and where one layer ends within about a
pixel behind another's edge.

It is a fair peer: all of a step is one compiled program, only pixels near an edge are visited, the
softness is what a pixel's own area does to a straight edge, and compilation is not timed.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import metadata

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from benchmarks.peers.descent import Gradient, ProjectedPetal, grid_faces

NAME = f"Soft rasteriser (JAX {metadata.version('jax')}) + Adam"
SOFTNESS = 0.25  # pixels: a sigmoid with the slope 1 / pixel of a covered area
_REACH = 3  # pixels from an edge beyond which coverage is 0 or 1
_BEYOND = 1.2  # pixels from an edge where it is asked whether another triangle lies beyond
_FOLDS = 768  # edges kept for folds; oblique petals of this mesh have 150 to 400
_SLACK = 1.5  # by which triangles may grow beyond those of the start


def available() -> str | None:
    """None: it needs nothing but petalfit's own dependencies."""
    return None


def gradient_of(mask: np.ndarray, petal: ProjectedPetal) -> Gradient:
    """Of the mean squared difference between a mask and the blurred silhouette."""
    raster = soft_raster(mask.shape, np.asarray(petal.project(np.zeros(len(petal.scale)))[0]))
    target = jnp.asarray(mask, jnp.float32)

    def misfit(z: jax.Array) -> jax.Array:
        return jnp.mean((raster(petal.project(z)[0].reshape(-1, 2)) - target) ** 2)

    program = jax.jit(jax.value_and_grad(misfit))

    def gradient(z: np.ndarray, step: int) -> tuple[float, np.ndarray]:
        loss, slope = program(jnp.asarray(z, jnp.float32))
        return float(loss), np.asarray(slope, np.float64)

    return gradient


def soft_raster(shape: tuple[int, int], start: np.ndarray) -> Callable[[jax.Array], jax.Array]:
    """A function from projected vertices (n, 2) to coverage, for triangles like the start's."""
    faces, (edges, sides) = grid_faces(), _edges()
    corners = start.reshape(-1, 2)[faces]
    longest = _SLACK * np.ptp(corners, axis=1).max()
    tile = _window(int(np.ceil(longest)) + 2)
    band = _window(int(np.ceil(longest)) + 2 * _REACH + 1)
    rim = jnp.asarray(sides[:, 1] < 0)

    def inside(xy: jax.Array) -> jax.Array:
        corner = xy[faces]
        pixel = jnp.floor(corner.min(axis=1)).astype(int)[:, None] + tile
        a, b, c = (corner[:, None, k] - (pixel + 0.5) for k in range(3))
        turns = jnp.stack([_cross(a, b), _cross(b, c), _cross(c, a)])
        covered = (turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)
        hard = jnp.zeros(shape, bool)
        return hard.at[_index(pixel)].max(covered, mode="drop")

    def outline(xy: jax.Array, hard: jax.Array) -> tuple[jax.Array, jax.Array]:
        corner = xy[faces]
        area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        fold = area[sides[:, 0]] * area[sides[:, 1]] < 0
        (chosen,) = jnp.nonzero(rim | fold, size=rim_count + _FOLDS, fill_value=-1)
        ends = xy[jnp.asarray(edges)[chosen]]
        along = ends[:, 1] - ends[:, 0]
        across = jnp.stack([-along[:, 1], along[:, 0]], -1)
        across /= jnp.linalg.norm(across, axis=-1, keepdims=True) + 1e-9
        both = [_look_up(hard, ends.mean(axis=1) + side * across) for side in (_BEYOND, -_BEYOND)]
        return ends, (chosen >= 0) & ~(both[0] & both[1])

    def raster(xy: jax.Array) -> jax.Array:
        hard = inside(lax.stop_gradient(xy))
        ends, seen = outline(xy, hard)
        low = jnp.floor(lax.stop_gradient(ends).min(axis=1)).astype(int) - _REACH
        pixel = low[:, None] + band
        start, along = ends[:, None, 0], (ends[:, 1] - ends[:, 0])[:, None]
        centre = pixel + 0.5
        share = ((centre - start) * along).sum(-1) / ((along**2).sum(-1) + 1e-12)
        gap = centre - start - jnp.clip(share, 0, 1)[..., None] * along
        distance = jnp.sqrt((gap**2).sum(-1) + 1e-8)
        distance = jnp.where(seen[:, None], distance, _REACH)
        at = _index(pixel)
        fixed = lax.stop_gradient(distance)
        nearest = jnp.full(shape, float(_REACH)).at[at].min(fixed, mode="drop")
        wins = fixed <= nearest.at[at].get(mode="fill", fill_value=-1.0)
        wins &= fixed < _REACH
        count = jnp.zeros(shape).at[at].add(wins, mode="drop")
        total = jnp.zeros(shape).at[at].add(jnp.where(wins, distance, 0), mode="drop")
        distance = jnp.where(count > 0, total / jnp.maximum(count, 1), _REACH)
        return jax.nn.sigmoid(jnp.where(hard, distance, -distance) / SOFTNESS)

    rim_count = int(np.sum(sides[:, 1] < 0))
    return raster


def _edges() -> tuple[np.ndarray, np.ndarray]:
    """All edges (e, 2) of the mesh and the faces on their two sides (e, 2), the second −1 at a rim."""
    faces = grid_faces()
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    pairs, owner = pairs[order], owner[order]
    edges, first, count = np.unique(pairs, axis=0, return_index=True, return_counts=True)
    second = np.where(count == 2, owner[np.minimum(first + 1, len(owner) - 1)], -1)
    return edges, np.stack([owner[first], second], -1)


def _window(side: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)


def _cross(a: jax.Array, b: jax.Array) -> jax.Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _look_up(hard: jax.Array, place: jax.Array) -> jax.Array:
    return hard.at[_index(jnp.floor(place).astype(int))].get(mode="fill", fill_value=False)


def _index(pixel: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Row and column; a negative one, which would count from the end, becomes out of bounds."""
    pixel = jnp.where(pixel < 0, np.iinfo(np.int32).max, pixel)
    return pixel[..., 1], pixel[..., 0]
