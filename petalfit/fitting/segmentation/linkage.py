"""Clustering of points by signed evidence: average linkage, moves of single points, and wide contacts."""

from __future__ import annotations

import heapq

import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array

from petalfit.fitting.segmentation.pairs import Pairs, width_of

_SMALL = 60  # points; smaller facets join others by any contact
_WIDE = 0.6  # width of a contact of two facets, by the root of the smaller one's number of points
_AGAINST = (
    1.5  # evidence against a contact, by that for it, which prevents that two clusters are joined
)
_UNCHANGED = 1e-3
_MOVES = 5


def facets(pairs: Pairs, count: int) -> Int[np.ndarray, " n"]:
    """The facet of every point, by average linkage of signed evidence (GASP; Bailoni and others, 2022).

    The two clusters with the largest mean evidence between them are joined, until no mean is positive.
    Two clusters of some size need a wide contact too, because sheets touch along narrow ones.

    Args:
        pairs: The pairs of near points.
        count: The number of points.
    """
    beside: list[dict[int, tuple[float, int]]] = [{} for _ in range(count)]
    rows = zip(pairs.one.tolist(), pairs.other.tolist(), pairs.same.tolist(), strict=True)
    heap = []
    for a, b, evidence in rows:
        beside[a][b] = beside[b][a] = (evidence, 1)
        if evidence > 0:
            heap.append((-evidence, a, b, 1))
    heapq.heapify(heap)
    parent, size = list(range(count)), [1] * count
    while heap:
        mean, a, b, links = heapq.heappop(heap)
        of_a, of_b = beside[a], beside[b]
        if b not in of_a:
            continue  # one of them has been joined to another cluster
        total, number = of_a[b]
        if number != links or total / number != -mean:
            continue  # more links have been added since
        smaller = min(size[a], size[b])
        if smaller > _SMALL and width_of(total) < _WIDE * smaller**0.5:
            continue
        if len(of_a) < len(of_b):
            a, b, of_a, of_b = b, a, of_b, of_a
        parent[b], beside[b] = a, {}
        size[a] += size[b]
        del of_a[b]
        for other, (evidence, links) in of_b.items():
            if other == a:
                continue
            of_other = beside[other]
            del of_other[b]
            before = of_a.get(other, (0.0, 0))
            joined = (before[0] + evidence, before[1] + links)
            of_a[other] = of_other[a] = joined
            if joined[0] > 0:
                heapq.heappush(heap, (-joined[0] / joined[1], a, other, joined[1]))
    for k in range(count):
        while parent[k] != parent[parent[k]]:
            parent[k] = parent[parent[k]]
    return np.unique(parent, return_inverse=True)[1]


def moved(labels: Int[np.ndarray, " n"], pairs: Pairs, least: float) -> Int[np.ndarray, " n"]:
    """The labels after every point has moved to the cluster for which there is most evidence.

    Args:
        labels: A cluster for every point, −1 for none.
        pairs: The pairs of near points.
        least: The number of points below which a cluster is dissolved.

    Returns:
        Labels; −1 where the evidence speaks for no cluster.
    """
    n, count = len(labels), count_of(labels)
    row = np.concatenate([pairs.one, pairs.other])
    column = np.concatenate([pairs.other, pairs.one])
    evidence = np.tile(pairs.same, 2)
    for _ in range(_MOVES):
        sizes = np.bincount(labels[labels >= 0], minlength=max(count, 1))
        theirs = labels[column]
        counts = (theirs >= 0) & (sizes[theirs] >= least)
        cells = (evidence[counts], (row[counts], theirs[counts]))
        votes = coo_array(cells, shape=(n, max(count, 1))).toarray()
        best = votes.argmax(axis=1)
        found = np.where(votes[np.arange(n), best] > 0, best, -1)
        changed, labels = np.mean(found != labels), found
        if changed < _UNCHANGED:
            break
    return labels


def joined(labels: Int[np.ndarray, " n"], pairs: Pairs, width: float) -> Int[np.ndarray, " n"]:
    """The labels after clusters with wide contacts have been joined, the widest first.

    Args:
        labels: A cluster for every point, −1 for none.
        pairs: The pairs of near points.
        width: The least width of a contact; see `contact_widths`.
    """
    while widths := contact_widths(labels, pairs):
        (into, gone), widest = max(widths.items(), key=lambda item: item[1])
        if widest < width:
            break
        labels = np.where(labels == gone, into, labels)
    return labels


def contact_widths(labels: Int[np.ndarray, " n"], pairs: Pairs) -> dict[tuple[int, int], float]:
    """The widths of the contacts of any two clusters, by the root of the smaller one's number of points.

    The smaller label comes first. A contact has no width if there is more evidence against one smooth
    sheet across it than for it.
    """
    a, b = labels[pairs.one], labels[pairs.other]
    across = (a >= 0) & (b >= 0) & (a != b)
    sizes = np.bincount(labels[labels >= 0])
    keys = np.minimum(a, b)[across] * len(sizes) + np.maximum(a, b)[across]
    keys, where = np.unique(keys, return_inverse=True)
    evidence = pairs.smooth[across]
    given = np.bincount(where, np.maximum(evidence, 0), minlength=len(keys))
    against = np.bincount(where, np.maximum(-evidence, 0), minlength=len(keys))
    given, against = (
        given.astype(float),
        against.astype(float),
    )  # if there are none, they are integers
    one, other = keys // max(len(sizes), 1), keys % max(len(sizes), 1)
    width = np.asarray(width_of(given)) / np.sqrt(np.minimum(sizes[one], sizes[other]))
    width[against > _AGAINST * given] = 0.0
    return dict(zip(zip(one.tolist(), other.tolist(), strict=True), width.tolist(), strict=True))


def count_of(labels: Int[np.ndarray, " n"]) -> int:
    """The number of clusters."""
    return int(labels.max(initial=-1)) + 1


def members_of(labels: Int[np.ndarray, " n"]) -> list[Int[np.ndarray, " _"]]:
    """The indices of the points of each cluster."""
    return [np.flatnonzero(labels == label) for label in range(count_of(labels))]


def renumbered(labels: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The labels as numbers from 0 without gaps; −1 stays."""
    used, where = np.unique(labels, return_inverse=True)
    return where - int(used[0] < 0)
