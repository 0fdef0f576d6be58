"""The posterior of a smoothed spline surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.spatial import KDTree

from petalfit.components import SplinePetal
from petalfit.fitting.families.spline.equations import COUNT, Equations, rows_at, surface_of
from petalfit.fitting.families.spline.margin import Margin, gap
from petalfit.fitting.inference.coverage import reached_from_the_edge
from petalfit.residuals import frames, places, refine_foot_points

_DRAWS = 64  # a standard deviation of so many is right to a tenth
# Standard deviation of slides of u and v along the surface, relative to its extent. They depend on how
# the cloud was flattened, and so do the places of base and tip.
_SLIDE = 0.02
_NEAR = 1.25  # spacings of the points, up to which the distances of two of them are compared
_CELLS = 12  # per side, in which points are counted
_THIN = 0.25  # of the expected number of points, below which a cell counts as empty
# Relief of the surface in a hole, which only its rim holds, relative to that elsewhere.
_HIDDEN = 8.0


class Posterior(NamedTuple):
    """A Gaussian approximation to the posterior of coefficients, and what it leaves out.

    Attributes:
        control: The mean, shape (k, 3).
        precision: The inverse of the covariance of all three coordinates of all coefficients.
        doubtful: The part of the area that is in doubt although no coefficient is: relief too small for
            the splines, and places outside of holes without points.
    """

    control: Float[np.ndarray, "k 3"]
    precision: Float[np.ndarray, "q q"]
    doubtful: float

    def draws(self) -> Float[np.ndarray, "d k 3"]:
        """Draws of the coefficients, always the same."""
        normal = np.random.default_rng(0).standard_normal((len(self.precision), _DRAWS))
        factor = np.linalg.cholesky(self.precision)
        away = solve_triangular(factor, normal, trans=1, lower=True)
        return self.control + away.T.reshape(_DRAWS, *self.control.shape)


def posterior_of(
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    control: Float[np.ndarray, "k 3"],
    uv: Float[np.ndarray, "n 2"],
    stiffness: Float[np.ndarray, "k k"],
    freedom: float,
    spacing: float,
) -> Posterior:
    """The posterior near smoothed coefficients, whose edges are moved outward to where the margin is.

    Args:
        points: The points.
        weights: Their weights.
        control: The smoothed coefficients.
        uv: Foot points near those on their surface.
        stiffness: The matrix of the cost of bending, for a weight of 1.
        freedom: Effective number of parameters.
        spacing: The side of the square that one point covers.
    """
    surface, n, total = surface_of(control), len(points), float(np.sum(weights))
    uv = refine_foot_points(surface, points, uv, 2)
    here = frames(surface, uv)
    distance, beyond = here.distance(points), np.max(here.beyond(points), axis=-1)
    variance = float(np.sum(weights * distance**2)) / total * n / max(n - freedom, 0.1 * n)
    margin = Margin.of(surface)
    perimeter = float(np.sum(margin.length))
    outside, holding = gap(beyond, float(np.sqrt(variance)), spacing, perimeter)
    slide = _SLIDE * float(np.linalg.norm(np.ptp(points, axis=0)))
    system = Equations(
        np.zeros_like(control), total * stiffness, np.full(COUNT, variance / COUNT / slide**2)
    )
    system.add(rows_at(uv), here.normal, np.zeros(n), weights)
    edge, share, inside = rows_at(margin.uv), margin.length / perimeter, system.matrix.copy()
    system.add(edge, margin.outward, np.full(len(share), outside), total * share)
    moved = control + system.solved()
    # Each point that holds the edges has a gap of its own, with an exponential distribution, their number
    # has a Poisson distribution, and where the edges cannot follow the margin, they leave it.
    left = float(np.mean(beyond[beyond > 0] ** 2)) if holding else 0.0
    count = max(holding, 1.0)
    system.matrix = inside
    known = share * count * variance / (2 * (count * spacing**2 / perimeter) ** 2 + left)
    system.add(edge, margin.outward, np.zeros(len(share)), known)
    bare, hidden = _empty(surface, uv)
    relief = _relief(points, distance, spacing) * (1 + _HIDDEN * hidden)
    return Posterior(moved, system.matrix / variance, float(np.hypot(relief, bare)))


def _relief(
    points: Float[np.ndarray, "n 3"], distance: Float[np.ndarray, " n"], spacing: float
) -> float:
    """The part of the area that relief adds: half of the mean squared slope of the distances.

    The squared difference of the distances of two points is that of their noise, plus that of the slope,
    which grows with the square of the way between them.
    """
    pairs = KDTree(points).query_pairs(_NEAR * spacing, output_type="ndarray")
    if len(pairs) < 2:
        return 0.0
    way = np.sum((points[pairs[:, 0]] - points[pairs[:, 1]]) ** 2, axis=1)
    squares = (distance[pairs[:, 0]] - distance[pairs[:, 1]]) ** 2
    away = way - way.mean()
    slope = float(away @ squares) / max(float(away @ away), 1e-300)
    # A slope in two directions, of which the way between two points has one.
    return max(slope, 0.0)


def _empty(surface: SplinePetal, uv: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
    """The parts of the area that have hardly any points: along the edges, and in holes."""
    side = np.linspace(0, 1, _CELLS + 1)
    corners = np.stack(np.meshgrid(side - 0.5, side, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = places(surface, corners).reshape(_CELLS + 1, _CELLS + 1, 3)
    diagonals = grid[1:, 1:] - grid[:-1, :-1], grid[1:, :-1] - grid[:-1, 1:]
    area = 0.5 * np.linalg.norm(np.cross(*diagonals), axis=-1)
    count, _, _ = np.histogram2d(*uv.T, bins=[side - 0.5, side])
    thin = count < _THIN * len(uv) * area / area.sum()
    along = reached_from_the_edge(thin)
    return float(area[along].sum() / area.sum()), float(area[thin & ~along].sum() / area.sum())
