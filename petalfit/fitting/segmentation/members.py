"""The membership of points in fitted sheets: a mixture of these sheets and clutter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

if TYPE_CHECKING:
    import trimesh

_NEIGHBOURS = 12
_DOUBT = 0.02  # how often a point belongs to a sheet that none of its neighbours was found on
NEAR = 4.0  # a point this near to a sheet lies on it, in standard deviations of the noise
_ITERATIONS = 15
_FEWEST = 1e-3  # least share of clutter


class Sheet(NamedTuple):
    """A fitted sheet, sampled.

    Attributes:
        vertices: Places on the sheet, shape (m, 3).
        normals: The unit normals there, shape (m, 3).
        area: Its area.
    """

    vertices: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "m 3"]
    area: float

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> Sheet:
        """The sheet of a fine mesh."""
        vertices, normals = (np.asarray(x, float) for x in (mesh.vertices, mesh.vertex_normals))
        return cls(vertices, normals, float(mesh.area))

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The distances of points from the sheet, to within a small part of the mesh's cells."""
        _, nearest = KDTree(self.vertices).query(points)
        way = points - self.vertices[nearest]
        off = np.einsum("ni,ni->n", way, self.normals[nearest])
        aside = np.sqrt(np.maximum(np.sum(way**2, axis=1) - off**2, 0))
        cell = np.sqrt(self.area / len(self.vertices))
        return np.hypot(off, np.maximum(aside - cell, 0))

    def explained(self, points: Float[np.ndarray, "n 3"], noise: float) -> float:
        """The share of points that lie on the sheet, within four standard deviations of the noise."""
        return float(np.mean(self.distance(points) < NEAR * noise))


def memberships(
    points: Float[np.ndarray, "n 3"],
    sheets: Sequence[Sheet],
    seen: Float[np.ndarray, "m 3"],
    labels: Int[np.ndarray, " m"],
    noise: float,
) -> Float[np.ndarray, "n k"]:
    """The probability that each point belongs to each of several sheets, by expectation maximisation.

    Where sheets lie nearer to each other than a model follows them, the neighbours decide.

    Args:
        points: The points.
        sheets: The fitted sheets, numbered as in `labels`.
        seen: Points whose segments are known.
        labels: The segments of these, −1 for none.
        noise: Standard deviation of the points' distances from their sheets, at the least.
    """
    distance = np.stack([sheet.distance(points) for sheet in sheets], axis=-1)
    _, near = KDTree(seen).query(points, min(_NEIGHBOURS, len(seen)))
    votes = np.mean(labels[near][..., None] == np.arange(-1, len(sheets)), axis=1)
    prior = np.log(_DOUBT + (1 - _DOUBT) * votes)
    area = np.array([sheet.area for sheet in sheets])
    volume = float(np.prod(np.maximum(np.ptp(points, axis=0), noise)))
    share = np.full(1 + len(sheets), 1 / (1 + len(sheets)))
    spread = np.full(len(sheets), 3 * noise)
    found = np.zeros((len(points), 1 + len(sheets)))
    for _ in range(_ITERATIONS):
        density = -0.5 * (distance / spread) ** 2 - np.log(area * spread * np.sqrt(2 * np.pi))
        clutter = np.full((len(points), 1), -np.log(volume))
        logs = np.log(share) + prior + np.concatenate([clutter, density], axis=1)
        found = np.exp(logs - logs.max(axis=1, keepdims=True))
        found = found / found.sum(axis=1, keepdims=True)
        share = np.maximum(found.mean(axis=0), _FEWEST / len(share))
        total = np.maximum(found[:, 1:].sum(axis=0), 1e-9)
        spread = np.sqrt(np.sum(found[:, 1:] * distance**2, axis=0) / total)
        spread = np.clip(spread, noise, 10 * noise)
    return found[:, 1:]
