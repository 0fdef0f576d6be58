"""The linearised likelihood of a fitted cloud, for discrepancies and for draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.inference.discrepancy import CELLS, Rows, is_suspect
from petalfit.fitting.likelihood.linearise import Linearisation, linearise
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import PointCloud
from petalfit.residuals import Data
from petalfit.surfaces import AbstractSurface, cells

_MOST = 8192  # so many points are enough to estimate a field that is smooth


def may_have_misfit(end: Iterate, free: int) -> bool:
    """Whether the distances from an end show more than noise at a first look.

    Args:
        end: The end of a fit to one cloud.
        free: The number of free parameters.
    """
    (seen,) = end.residuals
    if seen.uv is None:
        return False
    cell = _cell(end, seen.uv)
    return is_suspect(cell, seen.distance, seen.weights, free)


class Linear(NamedTuple):
    """The likelihood of some points of a cloud, linearised by the values of the parameters.

    Attributes:
        data: The points, with weights that add up to those of the whole cloud.
        uv: Their foot points, shape (n, 2).
        here: The linearisation by coordinates.
        by_value: dt/dθ, which turns derivatives by coordinates into those by values, shape (p,).
    """

    data: Data
    uv: Float[np.ndarray, "n 2"]
    here: Linearisation
    by_value: Float[np.ndarray, " p"]

    @classmethod
    def of(
        cls,
        model: AbstractSurface,
        names: Sequence[str],
        cloud: PointCloud,
        weights: Float[np.ndarray, " m"],
        noise: float,
        uv: Float[np.ndarray, "m 2"],
        some: Int[np.ndarray, " k"],
    ) -> Linear:
        """Linearises at a model.

        Args:
            model: The model, in the cloud's frame.
            names: Names of the free parameters.
            cloud: The cloud.
            weights: Weights of all points.
            noise: The noise.
            uv: Foot points of all points.
            some: Indices of the points that are used; they stand for the others.
        """
        share = float(np.sum(weights)) / max(float(np.sum(weights[some])), 1e-300)
        coordinates = Coordinates.of(model, tuple(names))
        t = coordinates.inverse(model)
        data = Data.of(cloud.points[some], weights[some] * share, noise)
        here = linearise(coordinates, data, t, uv[some])
        slopes = np.asarray(coordinates.slopes(t))
        by_value = np.where(slopes > 0, 1 / np.where(slopes > 0, slopes, 1.0), 0.0)
        return cls(data, uv[some], here, by_value)


def rows_of(end: Iterate, names: Sequence[str], cloud: PointCloud) -> Rows | None:
    """The rows of the likelihood of a cloud at an end; None if the surface has no foot points."""
    (seen,) = end.residuals
    if seen.uv is None:
        return None
    some = np.flatnonzero(seen.weights > 0)
    some = some[:: -(-len(some) // _MOST)]
    data, _, here, by_value = Linear.of(
        end.model, names, cloud, seen.weights, seen.noise, seen.uv, some
    )
    return Rows(
        here.position,
        _cell(end, seen.uv[some]),
        seen.distance[some],
        data.weights,
        here.slopes * by_value,
        here.edge * by_value,
        seen.noise,
        here.information * np.outer(by_value, by_value),
    )


def _cell(end: Iterate, uv: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    across, along = cells(end.model.domain, uv, CELLS)
    return np.asarray(across * CELLS + along)
