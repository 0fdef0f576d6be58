"""Flattening of a surface: distances along it become distances in a plane, however it is bent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from petalfit.fitting.likelihood.quadrature import around

_NEIGHBOURS = 10
_LANDMARKS = 150
# Steps from a node of a grid to its neighbours; with those the other way, sixteen of them.
_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
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
    landmarks = _spread(points, min(_LANDMARKS, len(points)))
    plane = _scaled(dijkstra(_neighbours(points), directed=False, indices=landmarks), landmarks)
    plane = plane - plane.mean(axis=0)
    _, turned = np.linalg.eigh(plane.T @ plane)
    return plane @ turned[:, ::-1]


def flat_outline(grid: Float[np.ndarray, "n_u n_v 3"]) -> Float[np.ndarray, "m 2"]:
    """The outline of a surface when it is laid flat, by classical scaling of distances along it.

    Args:
        grid: Nodes on the surface.

    Returns:
        Places in the plane of the nodes along the four sides, once around.
    """
    number = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
    rim = around(number)
    ways = dijkstra(_neighbours_in(grid, number), directed=False, indices=rim)
    return _scaled(ways[:, rim], np.arange(len(rim)))


def _scaled(
    ways: Float[np.ndarray, "k n"], landmarks: Sequence[int] | Int[np.ndarray, " k"]
) -> Float[np.ndarray, "n 2"]:
    """Places in a plane whose distances from landmarks are about the given ones."""
    squares = ways**2
    among = squares[:, landmarks]
    centring = np.eye(len(among)) - 1 / len(among)
    eigenvalues, vectors = np.linalg.eigh(-0.5 * centring @ among @ centring)
    axes = vectors[:, [-1, -2]] / np.sqrt(np.maximum(eigenvalues[[-1, -2]], 1e-300))
    return -0.5 * (squares - among.mean(axis=1, keepdims=True)).T @ axes


def _neighbours_in(
    grid: Float[np.ndarray, "n_u n_v 3"], number: Int[np.ndarray, "n_u n_v"]
) -> csr_array:
    """The graph of the nodes of a grid, each joined with those at most a knight's move away."""
    rows, columns, gaps = [], [], []
    for over, up in _MOVES:
        height, width = grid.shape[0] - over, grid.shape[1] - abs(up)
        here = np.s_[:height, max(-up, 0) : max(-up, 0) + width]
        there = np.s_[over:, max(up, 0) : max(up, 0) + width]
        rows.append(number[here].ravel())
        columns.append(number[there].ravel())
        gaps.append(np.linalg.norm(grid[here] - grid[there], axis=-1).ravel())
    edges = (np.concatenate(gaps), (np.concatenate(rows), np.concatenate(columns)))
    return csr_array(coo_array(edges, (number.size, number.size)))


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
