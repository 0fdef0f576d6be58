"""Tangent planes where sheets lie close together: most neighbours of a point may be on another sheet."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from petalfit.fitting.segmentation.neighbours import Neighbours

_TRIALS = (
    60  # planes through a point and two neighbours, of which the one with most support is kept
)
_CURVED = 0.15  # height of a curved sheet above its plane at the rim of a neighbourhood, in radii
_NEARER = 0.3  # neighbours nearer than this part of the radius count alike
_ALIKE = 0.35  # normals of one sheet differ by about this much within a neighbourhood, in rad
_SMOOTHINGS, _CANDIDATES = 3, 8


def tangent_planes(near: Neighbours, noise: float, seed: int) -> Float[np.ndarray, "n 3"]:
    """Unit normals of the sheets at all points, each of either sign.

    The plane with the largest support among the neighbours is found first. Then points take over the
    normals of their neighbours, where these are supported by more neighbours whose normals agree.

    Args:
        near: The neighbours of all points.
        noise: Standard deviation of the points' distances from their sheets.
        seed: The seed of the random choice of planes.
    """
    tolerance = 2 * noise + _CURVED * near.distance**2 / near.radius
    nearness = 1 / (_NEARER + near.distance / near.radius)
    normals = _supported(near, tolerance, nearness, np.random.default_rng(seed))
    for _ in range(3):
        normals = _fitted(near, _support(near, normals, tolerance))
    for _ in range(_SMOOTHINGS):
        normals = _agreed(near, normals, tolerance, nearness)
    return normals


def _support(
    near: Neighbours, normals: Float[np.ndarray, "n 3"], tolerance: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k"]:
    """How near the neighbours lie to the plane through each point, from 0 to 1."""
    height = np.einsum("nki,ni->nk", near.offset, normals)
    return np.exp(-0.5 * (height / tolerance) ** 2)


def _supported(
    near: Neighbours,
    tolerance: Float[np.ndarray, "n k"],
    nearness: Float[np.ndarray, "n k"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """The normals of the planes with the largest support among random ones."""
    n, k = near.others.shape
    best, normals, row = np.full(n, -1.0), np.zeros((n, 3)), np.arange(n)
    for _ in range(_TRIALS):
        first = rng.integers(0, k, n)
        second = (first + rng.integers(1, k, n)) % k
        normal = np.cross(near.offset[row, first], near.offset[row, second])
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        support = np.sum(nearness * _support(near, normal, tolerance), axis=1)
        better = support > best
        best[better], normals[better] = support[better], normal[better]
    return normals


def _fitted(near: Neighbours, weights: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n 3"]:
    """The normals of planes fitted to weighted neighbours, and to the points with weight 1."""
    total = 1 + weights.sum(axis=1)
    middle = np.einsum("nk,nki->ni", weights, near.offset) / total[:, None]
    spread = np.einsum("nk,nki,nkj->nij", weights, near.offset, near.offset)
    spread = spread - total[:, None, None] * middle[:, :, None] * middle[:, None, :]
    return np.linalg.eigh(spread)[1][:, :, 0]


def _agreed(
    near: Neighbours,
    normals: Float[np.ndarray, "n 3"],
    tolerance: Float[np.ndarray, "n k"],
    nearness: Float[np.ndarray, "n k"],
) -> Float[np.ndarray, "n 3"]:
    """The normals after each point has taken the best one, of its own and those of its neighbours."""
    theirs = normals[near.others]

    def agreement(own: np.ndarray) -> np.ndarray:
        square = np.einsum("nki,ni->nk", theirs, own) ** 2
        return _support(near, own, tolerance) * np.exp(-0.5 * (1 - square) / _ALIKE**2)

    chosen = normals
    best = np.sum(nearness * agreement(normals), axis=1)
    for column in range(_CANDIDATES):
        candidate = theirs[:, column]
        support = np.sum(nearness * agreement(candidate), axis=1)
        better = support > best
        best = np.where(better, support, best)
        chosen = np.where(better[:, None], candidate, chosen)
    for _ in range(2):
        chosen = _fitted(near, agreement(chosen))
    return chosen
