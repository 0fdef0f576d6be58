"""Pairs of near points, each with the evidence for or against lying on the same sheet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from petalfit.fitting.segmentation.neighbours import COUNT, Neighbours
from petalfit.fitting.segmentation.quadrics import Quadrics

# Tolerated distances of a point from the quadric and from the plane of another, in standard deviations of
# the noise and in distances between the two points.
_QUADRIC, _QUADRIC_FAR = 5.0, 0.02
_PLANE, _PLANE_FAR = 2.5, 0.15
_SMOOTH, _UNCREASED = 0.15, 0.2  # tolerated 1 − cos of the angle between two normals
# The evidence of all pairs across a line through a flat sheet, by the line's length in mean spacings.
_ACROSS = 0.119 * COUNT**1.5


class Pairs(NamedTuple):
    """Pairs of near points, each once.

    Attributes:
        one: Index of one point, shape (m,).
        other: Index of the other point, shape (m,).
        smooth: Evidence that both lie on one smooth sheet, however curved, from −1 to 1, shape (m,).
        same: The same for a sheet that hardly bends between the two, so that it ends at creases.
    """

    one: Int[np.ndarray, " m"]
    other: Int[np.ndarray, " m"]
    smooth: Float[np.ndarray, " m"]
    same: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, near: Neighbours, quadrics: Quadrics, noise: float) -> Pairs:
        """The pairs of all points and their neighbours."""
        n, k = near.others.shape
        normals = quadrics.normals
        cosine = np.abs(np.einsum("ni,nki->nk", normals, normals[near.others]))
        curved = np.maximum(np.abs(quadrics.residuals), np.abs(quadrics.above(near)))
        plane = np.maximum(
            np.abs(np.einsum("nki,ni->nk", near.offset, normals)),
            np.abs(np.einsum("nki,nki->nk", near.offset, normals[near.others])),
        )
        smooth = np.minimum(
            1 - curved / (_QUADRIC * noise + _QUADRIC_FAR * near.distance),
            1 - (1 - cosine) / _SMOOTH,
        )
        same = np.minimum(
            1 - plane / (_PLANE * noise + _PLANE_FAR * near.distance),
            1 - (1 - cosine) / _UNCREASED,
        )
        same = np.minimum(smooth, same)
        row, column = np.repeat(np.arange(n), k), near.others.ravel()
        one, other = np.minimum(row, column), np.maximum(row, column)
        _, once = np.unique(one * n + other, return_index=True)
        smooth, same = (np.clip(x.ravel()[once], -1, 1) for x in (smooth, same))
        return cls(one[once], other[once], smooth, same)

    def graph(self, inside: Int[np.ndarray, " n"], values: Float[np.ndarray, " m"]) -> csr_array:
        """The symmetric graph of the pairs among some points that speak for one smooth sheet.

        Args:
            inside: Indices of the points.
            values: The value of each pair of all points.
        """
        place = np.full(int(max(self.one.max(), self.other.max())) + 1, -1)
        place[inside] = np.arange(len(inside))
        a, b = place[self.one], place[self.other]
        kept = (a >= 0) & (b >= 0) & (self.smooth > 0)
        graph = coo_array((values[kept], (a[kept], b[kept])), shape=(len(inside), len(inside)))
        return csr_array(graph + graph.T)


def width_of(evidence: float | Float[np.ndarray, " m"]) -> float | Float[np.ndarray, " m"]:
    """The width of a contact in mean spacings of points, given the evidence of all pairs across it."""
    return evidence / _ACROSS
