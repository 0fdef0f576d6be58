"""Starts by support functions: candidates that reach as far as the target in all directions.

The support function says how far a shape reaches in every direction. It needs no matching: it is the
largest projection of all places of the surface, folds included. Evenly spread candidates are scored by
it, the best are improved by a few damped Gauss-Newton steps on it, and of similar ones the best is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.fitting.coordinates import Coordinates
from petalfit.observations import Contour
from petalfit.residuals import pull_back

T = TypeVar("T")
# Numbers of candidates and of those that are improved, and how many times more a thorough search takes:
# one compiled program serves both.
_TRIED, _TRIED_IMPROVED = 256, 32
_MORE, _MORE_IMPROVED = 8, 4
_STEPS = 8
_DIRECTIONS = 48
_NODES = 17  # per side of the domain
_DIFFERENT = 0.3  # least difference of two candidates, in standard deviations of the typical ranges
_TOLERANCE = 0.01  # unit of differences in support, relative to the contour's size
_PRIOR = 0.05  # weight of the prior, which keeps parameters of no influence in place


class Shadow(NamedTuple):
    """Places in an image, whose support function candidates should have.

    Attributes:
        matrix: The matrix of the camera, shape (3, 4).
        place: The places in the image, shape (n, 2).
        weight: Weight of each place, shape (n,); 0 where the contour is cut off.
    """

    matrix: Float[np.ndarray, "3 4"]
    place: Float[np.ndarray, "n 2"]
    weight: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, contour: Contour) -> Shadow:
        """The shadow inside a contour."""
        return cls(contour.camera.matrix, contour.place, contour.length)

    @property
    def size(self) -> float:
        """The diagonal of the box around the places."""
        return float(np.hypot(*np.ptp(self.place, axis=0)))


class Candidate(NamedTuple):
    """A surface that may have cast the shadows.

    Attributes:
        t: Coordinates of the surface, shape (p,).
        score: Distance of its support functions from those of the shadows; 0 is best.
    """

    t: Float[np.ndarray, " p"]
    score: float


def search(
    coordinates: Coordinates, shadows: Sequence[Shadow], most: int, thorough: bool = True
) -> list[Candidate]:
    """Different candidates, the best first, at most `most`.

    Args:
        coordinates: The free parameters; those that are held keep the template's values.
        shadows: The shadows that were observed, each from one direction.
        most: The largest number of candidates to return.
        thorough: Whether to try all candidates; else an eighth as many, and improve a quarter as many.
    """
    candidates, improving = _TRIED, _TRIED_IMPROVED
    if thorough:
        candidates, improving = _MORE * candidates, _MORE_IMPROVED * improving
    angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    matrices = np.stack([shadow.matrix for shadow in shadows])
    scale = np.array([_TOLERANCE * shadow.size for shadow in shadows])
    reach, known = np.empty((2, len(shadows), _DIRECTIONS))
    for k, shadow in enumerate(shadows):
        along = shadow.place @ directions.T
        reach[k] = np.max(along, axis=0)
        # Where the contour is cut off, the petal reaches at least so far: reaching farther costs nothing.
        known[k] = shadow.weight[np.argmax(along, axis=0)] > 0
    places = coordinates.spread(candidates)
    found = np.concatenate(
        [
            np.asarray(_supports(coordinates, some, matrices, directions), np.float64)
            for some in np.split(places, candidates // _TRIED)
        ]
    )
    gap = np.where((known == 0) & (found > reach), 0.0, found - reach) / scale[:, None]
    score = np.mean(np.log1p((gap / 3) ** 2), axis=(1, 2))
    best = places[np.argsort(score)[:improving]]
    # Not side by side: XLA divides the solutions of many systems among its threads, and two programs that
    # do so wait for each other for ever.
    parts = [
        _improve(coordinates, some, matrices, directions, reach, known, scale)
        for some in np.split(best, improving // _TRIED_IMPROVED)
    ]
    improved, score = (
        np.concatenate([np.asarray(x, np.float64) for x in part])
        for part in zip(*parts, strict=True)
    )
    chosen: list[Candidate] = []
    for k in np.argsort(score):
        if all(np.max(np.abs(improved[k] - other.t)) > _DIFFERENT for other in chosen):
            chosen.append(Candidate(improved[k], float(score[k])))
        if len(chosen) == most:
            break
    return chosen


_FRACTION = np.linspace(0.0, 1.0, _NODES)
_GRID = np.stack(np.meshgrid(_FRACTION, _FRACTION, indexing="ij"), axis=-1).reshape(-1, 2)


def _supports_of(
    coordinates: Coordinates, t: Array, matrices: Array, directions: Array
) -> tuple[Array, Array, Array]:
    """(u, v) of nodes, and for each view their homogeneous places in the image and projections."""
    model = coordinates.model(t)
    low, high = (jnp.asarray(side, t.dtype) for side in zip(*model.domain, strict=True))
    uv = low + (high - low) * jnp.asarray(_GRID, t.dtype)
    position = model.position(uv[:, 0], uv[:, 1])
    seen = jnp.einsum("vij,nj->vni", matrices[:, :, :3], position) + matrices[:, None, :, 3]
    return uv, seen, (seen[..., :2] / seen[..., 2:]) @ directions.T


def _view_supports(
    coordinates: Coordinates, candidates: Array, matrices: Array, directions: Array
) -> Array:
    coordinates, candidates, matrices, directions = _single(
        (coordinates, candidates, matrices, directions)
    )

    def one(t: Array) -> Array:
        return jnp.max(_supports_of(coordinates, t, matrices, directions)[2], axis=1)

    return jax.lax.map(one, candidates, batch_size=64)


def _single(tree: T) -> T:
    """Converts to single precision, which is enough for a start and takes half the time."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)


def _view_improvement(
    coordinates: Coordinates,
    candidates: Array,
    matrices: Array,
    directions: Array,
    reach: Array,
    known: Array,
    scale: Array,
) -> tuple[Array, Array]:
    """Damped Gauss-Newton steps on the support functions, and the scores before the last one."""
    coordinates, candidates, matrices, directions, reach, known, scale = _single(
        (coordinates, candidates, matrices, directions, reach, known, scale)
    )

    def step(t: Array, _: None) -> tuple[Array, Array]:
        uv, seen, along = _supports_of(coordinates, t, matrices, directions)
        farthest = jnp.argmax(along, axis=1)  # (views, directions)
        gap = jnp.max(along, axis=1) - reach
        gap = jnp.where((known == 0) & (gap > 0), 0.0, gap) / scale[:, None]
        place = jnp.take_along_axis(seen, farthest[..., None], axis=1)
        across = jnp.sum(directions * place[..., :2] / place[..., 2:], axis=-1)
        covectors = jnp.einsum("dk,vkj->vdj", directions, matrices[:, :2, :3])
        covectors = (covectors - across[..., None] * matrices[:, None, 2, :3]) / place[..., 2:]
        pulled = pull_back(
            coordinates.model(t), uv[farthest].reshape(-1, 2), covectors.reshape(-1, 3)
        )
        slopes = coordinates.gather(pulled) * coordinates.slopes(t)
        slopes = slopes / jnp.repeat(scale, len(directions))[:, None]
        gap = gap.reshape(-1)
        cauchy = 1 / (1 + gap**2)
        matrix = slopes.T @ (cauchy[:, None] * slopes) + (_PRIOR + 0.3) * jnp.eye(
            len(t), dtype=t.dtype
        )
        move = jnp.linalg.solve(matrix, slopes.T @ (cauchy * gap) + _PRIOR * t * coordinates.active)
        return (t - jnp.clip(move, -1.0, 1.0)).astype(t.dtype), jnp.mean(jnp.log1p(gap**2))

    def one(t: Array) -> tuple[Array, Array]:
        t, scores = jax.lax.scan(step, t, None, length=_STEPS)
        return t, scores[-1]

    return jax.lax.map(one, candidates, batch_size=32)


_supports = Program(_view_supports)
_improve = Program(_view_improvement)
