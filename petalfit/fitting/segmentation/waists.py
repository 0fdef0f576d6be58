"""Segments that consist of several sheets: they are cut at their waists."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh

from petalfit.fitting.segmentation.linkage import count_of
from petalfit.fitting.segmentation.neighbours import COUNT
from petalfit.fitting.segmentation.pairs import Pairs, width_of

_SHIFT = 1e-4  # keeps the Laplacian invertible


class Waist(NamedTuple):
    """The narrowest waist of a segment.

    Attributes:
        width: Its width by the root of the smaller part's number of points; infinite if there is none.
        part: Whether each point lies on one side of it, shape (m,).
    """

    width: float
    part: Bool[np.ndarray, " m"]


def cut_at_waists(
    labels: Int[np.ndarray, " n"], pairs: Pairs, width: float, least: float
) -> Int[np.ndarray, " n"]:
    """The labels after segments with a narrow waist have been cut there, and the parts again.

    Args:
        labels: A segment for every point, −1 for none.
        pairs: The pairs of near points.
        width: The width below which a waist separates two sheets.
        least: The number of points below which a part is none.
    """
    labels = labels.copy()
    count = count_of(labels)
    waiting = [*range(count)]
    while waiting:
        label = waiting.pop()
        inside = np.flatnonzero(labels == label)
        waist = narrowest_waist(inside, pairs, least)
        if waist.width < width:
            labels[inside[waist.part]] = count
            waiting += [label, count]
            count += 1
    return labels


def narrowest_waist(inside: Int[np.ndarray, " m"], pairs: Pairs, least: float) -> Waist:
    """The narrowest waist of a segment.

    Two sheets that touch are joined by a contact that is narrow beside both of them. It is sought along
    the slowest mode of diffusion within the segment (spectral bisection; Shi and Malik, 2000).

    Args:
        inside: The indices of the segment's points.
        pairs: The pairs of near points.
        least: The number of points that either part has at least.
    """
    return _waist(pairs.graph(inside, pairs.smooth), least)


def _waist(graph: csr_array, least: float) -> Waist:
    n = len(graph.indptr) - 1
    if n < 2 * least:
        return Waist(np.inf, np.zeros(n, bool))
    pieces, piece = connected_components(graph, directed=False)
    if pieces > 1:
        sizes = np.bincount(piece)
        first, second = np.argsort(-sizes)[:2]
        if sizes[second] >= least:
            return Waist(0.0, piece == second)
        largest = np.flatnonzero(piece == first)
        found, part = _waist(csr_array(graph[largest][:, largest]), least), np.zeros(n, bool)
        part[largest[found.part]] = True
        return Waist(found.width, part)
    degree = np.asarray(graph.sum(axis=1))
    root = diags_array(1 / np.sqrt(degree))
    laplacian = diags_array(np.full(n, 1 + _SHIFT)) - root @ graph @ root
    _, modes = eigsh(laplacian.tocsc(), k=2, sigma=0, v0=np.sqrt(degree))
    rank = np.empty(n, int)
    rank[np.argsort(modes[:, 1] / np.sqrt(degree))] = np.arange(n)
    links = graph.tocoo()
    low = np.minimum(rank[links.row], rank[links.col])
    high = np.maximum(rank[links.row], rank[links.col])
    begun, ended = (np.bincount(ends, links.data, minlength=n) for ends in (low, high))
    across: Float[np.ndarray, " m"] = 0.5 * np.cumsum(begun - ended)[:-1]
    # Evidence is weaker all over a sheet that is noisy or strongly bent, and so it is across its waist.
    usual = min(float(degree.mean()) / COUNT, 1.0)
    before = np.arange(1, n)
    smaller = np.minimum(before, n - before)
    width = np.asarray(width_of(across)) / usual / np.sqrt(smaller)
    width[smaller < least] = np.inf
    narrowest = int(np.argmin(width))
    return Waist(float(width[narrowest]), rank <= narrowest)
