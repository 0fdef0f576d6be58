"""The linearised likelihood of a fitted cloud, from which a discrepancy is estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.inference.discrepancy import CELLS, Rows, is_suspect
from petalfit.fitting.likelihood import programs
from petalfit.fitting.likelihood.cloud import pad
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import PointCloud
from petalfit.surfaces import cells

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


def rows_of(end: Iterate, names: Sequence[str], cloud: PointCloud) -> Rows | None:
    """The rows of the likelihood of a cloud at an end; None if the surface has no foot points."""
    (seen,) = end.residuals
    if seen.uv is None:
        return None
    some = np.flatnonzero(seen.weights > 0)
    some = some[:: -(-len(some) // _MOST)]
    count = len(some)
    scale = float(np.sum(seen.weights)) / max(float(np.sum(seen.weights[some])), 1e-300)
    data = pad(cloud.points[some], seen.weights[some] * scale, seen.noise)
    uv = np.concatenate([seen.uv[some], np.repeat(seen.uv[some[:1]], len(data.points) - count, 0)])
    coordinates = Coordinates.of(end.model, tuple(names))
    t = coordinates.inverse(end.model)
    here = programs.linearise(coordinates, data, t, uv)
    slopes = np.asarray(coordinates.slopes(t))
    by_value = np.where(slopes > 0, 1 / np.where(slopes > 0, slopes, 1.0), 0.0)
    return Rows(
        np.asarray(here.position)[:count],
        _cell(end, seen.uv[some]),
        seen.distance[some],
        seen.weights[some] * scale,
        np.asarray(here.slopes)[:count] * by_value,
        np.asarray(here.edge)[:count] * by_value,
        seen.noise,
        np.asarray(here.information) * np.outer(by_value, by_value),
    )


def _cell(end: Iterate, uv: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    across, along = cells(end.model.domain, uv, CELLS)
    return np.asarray(across * CELLS + along)
