"""Cells of a surface, which the points of a large cloud are sorted into.

A smooth surface does not need millions of points in every step. Cells are small beside every bend of the
surface, and near its edges they are narrow bands along them. The points of a cell count as two, one
standard deviation before the mean of their places and behind it, at mean distances from the surface that
follow their trend across the cell, with half the sum of their weights. To first order in the change of
the surface the likelihood is that of all points.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.likelihood.relief import Located, Relief, dot, on_all_cores
from petalfit.surfaces import AbstractSurface

# How far bands along an edge reach outside, and from where on they widen, in units of the blur.
_OUTSIDE, _WIDENING = 16.0, 6.0
_AT_CORNERS = 8  # cells into which those at corners are divided across the surface
_TINY = 1e-9  # a smaller spread of the points of a cell is none


@dataclasses.dataclass(frozen=True)
class Cells:
    """The cells that the points of a cloud are sorted into.

    Attributes:
        across: The number of cells across the surface, far from its edges.
        along: The same along the surface.
        band: The width of the bands along an edge, in units of the blur.
        inside: How far the bands reach inside, in units of the blur.
    """

    across: int
    along: int
    band: float
    inside: float = 8.0

    @property
    def bands(self) -> int:
        """The number of bands at each edge."""
        return math.ceil((self.inside + _OUTSIDE) / self.band)

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and columns, with the bands at both ends."""
        return self.across + 2 * self.bands, self.along + 2 * self.bands

    @property
    def most(self) -> int:
        """The number of cells, with those that are empty."""
        return math.prod(self.shape) + (2 * self.bands) ** 2 * _AT_CORNERS

    def sorted(
        self, relief: Relief, near: Located, blur: float
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """The number of the cell of each point, and its place across the cell, the narrow way."""
        low, high = relief.domain.T
        shares, beyond = (near.uv - low) / (high - low), near.beyond / blur
        # Far beyond an edge bands widen, as logarithms do.
        wide = _WIDENING * (1 + np.log(np.maximum(beyond, _WIDENING) / _WIDENING))
        band = (np.where(beyond > _WIDENING, wide, beyond) + self.inside) / self.band
        band = np.clip(band, 0, self.bands - 1).astype(int) + np.where(shares < 0.5, 0, self.bands)
        counts = np.array([self.across, self.along])
        inside = np.clip(shares * counts, 0, counts - 1).astype(int)
        free = beyond < -self.inside
        number = np.ravel_multi_index(tuple(np.where(free, inside, counts + band).T), self.shape)
        # Where two edges meet at a small angle, the bands of both go on along them.
        corner = np.ravel_multi_index(tuple(band.T), (2 * self.bands, 2 * self.bands))
        corner = math.prod(self.shape) + corner * _AT_CORNERS + inside[:, 0] % _AT_CORNERS
        place = np.where(free[:, 0], np.where(free[:, 1], shares[:, 0], beyond[:, 1]), beyond[:, 0])
        return np.where(np.any(free, axis=1), number, corner), place


class Condensed(NamedTuple):
    """The points that stand for those of a cloud, two for each cell with more than one point.

    Attributes:
        points: Where they lie, shape (n, 3).
        weights: The number of observations that each counts for, shape (n,).
        uv: Their places on the surface, shape (n, 2).
        scattered: Σ w |x − x̄|² of the points of the cloud about those that stand for them.
        squares: Σ w d² of the points of the cloud, with d their distances along the normal.
        foot_points: The foot points of all points of the cloud, shape (m, 2).
    """

    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    uv: Float[np.ndarray, "n 2"]
    scattered: float
    squares: float
    foot_points: Float[np.ndarray, "m 2"]


def condense(
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    surface: AbstractSurface,
    blur: float,
    cells: Cells,
) -> Condensed:
    """Condenses a cloud near a surface. Call it inside `jax.enable_x64(True)`.

    Args:
        points: The points.
        weights: The number of observations that each point counts for.
        surface: The surface, which lies nearly where the cloud does.
        blur: How far points are spread over its edges: the blur τ, or the noise σ.
        cells: The size of the cells.
    """
    relief, foot_points = Relief.of(surface), np.empty((len(points), 2))

    def sums_over(parts: Sequence[slice]) -> Float[np.ndarray, "17 m"]:
        sums = np.zeros((17, cells.most))
        for part in parts:
            some, weight = points[part], weights[part]
            near = relief.located(some)
            foot_points[part] = near.uv
            number, place = cells.sorted(relief, near, blur)
            off, distance = some - near.place, near.distance
            across = off - distance[:, None] * near.normal
            columns = np.column_stack([near.uv, across, distance])
            moments = np.ones(len(some)), place, place**2, dot(off, off), distance**2
            for k, column in enumerate([*moments, *columns.T, *(place[:, None] * columns).T]):
                sums[k] += np.bincount(number, weight * column, cells.most)
        return sums

    sums = np.sum(on_all_cores(sums_over, len(points)), axis=0)
    sums = sums[:, sums[0] > 0].T
    mass, (whole, squares) = sums[:, 0].copy(), np.sum(sums[:, 3:5], axis=0).tolist()
    sums /= mass[:, None]
    mean, place = sums[:, 5:11], sums[:, 1]
    spread = np.sqrt(np.maximum(sums[:, 2] - place**2, 0.0))
    split = np.flatnonzero(spread > _TINY)
    turned = (sums[split, 11:] - place[split, None] * mean[split]) / spread[split, None]
    # A cell counts as two points, one standard deviation before its middle and behind it.
    mass[split] /= 2
    mean, mass = np.concatenate([mean, mean[split] + turned]), np.append(mass, mass[split])
    mean[split] -= turned
    uv, across, distance = np.split(mean, [2, 5], axis=1)
    # The mean of places on a bent surface lies beside it; the mean distance is that from the surface.
    place, normal = relief.at(uv)
    off = across + distance * normal
    scattered = max(whole - float(mass @ dot(off, off)), 0.0)
    return Condensed(place + off, mass, uv, scattered, squares, foot_points)
