"""Flattening of a surface: distances along it become distances in a plane, however it is bent."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

_NEIGHBOURS = 10
_LANDMARKS = 150
_TEAR = 1.5  # widest gap of a tear that is bridged, in units of its narrowest gap


def flatten(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Flattens points of a surface by Landmark Isomap (de Silva and Tenenbaum, 2002).

    Distances along the surface are approximated by shortest paths through a graph of neighbours.
    Classical scaling of the distances between landmarks gives places in the plane.

    Args:
        points: Points of one surface, at least 12.

    Returns:
        Places in the plane, centred, with the first axis along the longer side.
    """
    graph = _neighbours(points)
    landmarks = _spread(points, min(_LANDMARKS, len(points)))
    squares = dijkstra(graph, directed=False, indices=landmarks) ** 2
    among = squares[:, landmarks]
    centring = np.eye(len(landmarks)) - 1 / len(landmarks)
    eigenvalues, vectors = np.linalg.eigh(-0.5 * centring @ among @ centring)
    axes = vectors[:, [-1, -2]] / np.sqrt(np.maximum(eigenvalues[[-1, -2]], 1e-300))
    plane = -0.5 * (squares - among.mean(axis=1, keepdims=True)).T @ axes
    plane = plane - plane.mean(axis=0)
    _, turned = np.linalg.eigh(plane.T @ plane)
    return plane @ turned[:, ::-1]


def _neighbours(points: Float[np.ndarray, "n 3"]) -> csr_array:
    """The graph of nearest neighbours, with short edges added until all its pieces are joined."""
    n = len(points)
    gaps, others = map(np.asarray, KDTree(points).query(points, min(_NEIGHBOURS, n - 1) + 1))
    rows = np.repeat(np.arange(n), gaps.shape[1] - 1)
    graph = csr_array(coo_array((gaps[:, 1:].ravel(), (rows, others[:, 1:].ravel())), (n, n)))
    while True:
        pieces, label = connected_components(graph, directed=False)
        if pieces == 1:
            return graph
        small = np.argmin(np.bincount(label))
        inside, outside = np.flatnonzero(label == small), np.flatnonzero(label != small)
        gap, nearest = map(np.asarray, KDTree(points[outside]).query(points[inside]))
        # Edges are added all along a tear, because paths over a single bridge would be detours.
        k = np.flatnonzero(gap <= _TEAR * gap.min())
        bridge = coo_array((gap[k], (inside[k], outside[nearest[k]])), (n, n))
        graph = csr_array(graph + bridge)


def _spread(points: Float[np.ndarray, "n 3"], count: int) -> list[int]:
    """Indices of points far apart: each is the farthest from those before; the first from the middle."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    gaps = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gaps)))
        gaps = np.minimum(gaps, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen
