"""Segments of several petals that are fused at their bases: they are cut between their lobes."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from petalfit.fitting.segmentation.pairs import Pairs

# How far a lobe reaches beyond the place where it parts from a longer one, by the way from its tip to the
# base. Corners and notches of petals stand out by at most 0.25, petals by 0.36 or more.
_STANDS_OUT = 0.32
_NEARLY = 0.25  # relative difference from it at which the number of lobes is in doubt
_LONG = 0.5  # the least way to the base, by that of the farthest lobe
_FEWEST = 3  # lobes that a segment has which is a flower by itself
_SOURCES = 0.005  # the part of a segment's points that is its base


@dataclasses.dataclass(frozen=True)
class Lobes:
    """The lobes of a segment.

    Attributes:
        labels: The lobe of every point, from 0, shape (m,).
        count: The number of lobes.
        rivals: 1 if another lobe nearly stands out, −1 if one of them hardly does, both or neither.
    """

    labels: Int[np.ndarray, " m"]
    count: int
    rivals: frozenset[int]


def lobes_of(
    points: Float[np.ndarray, "n 3"],
    inside: Int[np.ndarray, " m"],
    pairs: Pairs,
    base: Float[np.ndarray, "3"] | None,
    least: float,
) -> Lobes:
    """The lobes of a segment: the parts that reach far from its base, each on a way of its own.

    The way from the base along the sheet has a maximum at the tip of every petal. Petals that are fused
    at their bases differ from a petal with several corners by how far they reach beyond the place where
    they part, which is the persistence of the maximum (Edelsbrunner and others, 2002).

    Args:
        points: The points of the cloud.
        inside: The indices of the segment's points.
        pairs: The pairs of near points of the cloud.
        base: A place near the base; None if it is not known, and a segment of three lobes or more has it
            in their middle.
        least: The number of points that a lobe has at least.
    """
    whole = Lobes(np.zeros(len(inside), int), 1, frozenset())
    if len(inside) < 2 * least:
        return whole
    graph = pairs.graph(inside, np.linalg.norm(points[pairs.one] - points[pairs.other], axis=1))
    away = _from_base(graph, points[inside], base)
    tips, rivals = _tips(graph, away, least)
    if base is None and len(tips) < _FEWEST:
        return whole
    if not tips:
        return dataclasses.replace(whole, rivals=rivals)
    bodies = np.full(len(inside), -1)
    for number, (tip, parting) in enumerate(tips):
        beyond = np.flatnonzero(away > parting)
        piece = connected_components(graph[beyond][:, beyond], directed=False)[1]
        bodies[beyond[piece == piece[np.searchsorted(beyond, tip)]]] = number
    # What lies nearer to the base belongs to the nearest lobe.
    known = np.flatnonzero(bodies >= 0)
    nearest = dijkstra(graph, indices=known, min_only=True, return_predecessors=True)[2]
    reached = nearest >= 0
    labels = np.where(reached, bodies[np.where(reached, nearest, known[0])], 0)
    return Lobes(labels, len(tips), rivals)


def _from_base(
    graph: csr_array, points: Float[np.ndarray, "m 3"], base: Float[np.ndarray, "3"] | None
) -> Float[np.ndarray, " m"]:
    """The ways of all points to the base along the sheet; 0 where there is none."""
    count = max(int(_SOURCES * len(points)), 5)
    near = points.mean(axis=0) if base is None else base
    sources = np.argsort(np.linalg.norm(points - near, axis=1))[:count]
    away = np.asarray(dijkstra(graph, indices=sources, min_only=True))
    return np.where(np.isfinite(away), away, 0.0)


def _tips(
    graph: csr_array, away: Float[np.ndarray, " m"], least: float
) -> tuple[list[tuple[int, float]], frozenset[int]]:
    """The tips of the lobes that stand out, and the distance from the base where each meets another.

    Also the rivals; see `Lobes`. A single lobe has no tip.
    """
    count = len(away)
    pieces, size, tip = DisjointSet(range(count)), [0] * count, [*range(count)]
    order = np.argsort(-away, kind="stable")
    starts, others = (np.asarray(part).tolist() for part in (graph.indptr, graph.indices))
    seen = [False] * count
    first, farthest = int(order[0]), float(away[order[0]])
    parted: dict[int, float] = {}  # where the lobe of a tip first met another
    lobes: list[int] = []
    rivals: set[int] = set()
    for k in order.tolist():
        seen[k], size[k] = True, 1
        above = {pieces[m] for m in others[starts[k] : starts[k + 1]] if seen[m] and m != k}
        longest, *shorter = [*sorted(above, key=lambda r: -away[tip[r]]), k]
        for one in shorter:
            reach, here = float(away[tip[one]]), float(away[k])
            if one != k and size[one] >= least and reach > _LONG * farthest:
                stands_out = (reach - here) / reach
                if abs(stands_out / _STANDS_OUT - 1) < _NEARLY:
                    rivals.add(-1 if stands_out > _STANDS_OUT else 1)
                if stands_out > _STANDS_OUT:
                    lobes.append(tip[one])
                    parted.setdefault(tip[one], here)
                    parted.setdefault(tip[longest], here)
            pieces.merge(longest, one)
            joined = pieces[longest]
            size[joined], tip[joined] = size[longest] + size[one], tip[longest]
            longest = joined
    if lobes:
        lobes.append(first)
    return [(place, parted[place]) for place in lobes], frozenset(rivals)
