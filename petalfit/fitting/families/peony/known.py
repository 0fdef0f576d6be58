"""Starts of peony petals in a known pose: outline and heights, then possible ribs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from petalfit.components import PeonyPetal
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.families.peony.outline import Heights, fit_amplitudes, fit_outline
from petalfit.fitting.families.peony.ribs import RIBS, close, ribs_beside, with_ribs
from petalfit.fitting.families.polish import START_POINTS
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.outliers.annealing import approach, term_of
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.solver.alternate import minimise
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import report
from petalfit.residuals import Data

_LENGTHS = (16.0, 21.0, 27.0, 35.0)  # lengths b_y that are tried if the tip is missing


def known_starts(
    coordinates: Coordinates[PeonyPetal], scan: Scan
) -> Iterator[tuple[str, PeonyPetal]]:
    """Starts with their labels, one for each rib frequency that the cloud allows."""
    template, free = coordinates.template, coordinates.free
    some = scan.some(START_POINTS)
    points = scan.points[some]
    data = Data.of(points, scan.weights[some], None)
    report("searching the outline")
    outline, complete = fit_outline(template, free, points)
    polished = _smooth(coordinates, outline, data)
    if "b_y" in free and not complete:
        # Without its tip a petal has the outline of a shorter one, so that several lengths are tried.
        rest = [name for name in free if name != "b_y"]
        for length in _LENGTHS:
            longer = with_values(template, {"b_y": length})
            outline, _ = fit_outline(longer, rest, points)
            polished = min(
                polished,
                _smooth(coordinates, outline, data),
                key=lambda start: float(start.terms[0].sigma),
            )
    if scan.background is not None:
        # A few strays that seem to belong to a surface would bend the petal.
        held = coordinates.holding(RIBS).around(polished.model)
        weights = scan.weights[some]
        polished = approach(held, scan.background, polished.model, points, weights)
    smooth, term = polished.model, term_of(polished)
    if not set(RIBS) & set(free):
        yield "the outline", with_values(smooth, {"rib_amplitude": template.rib_amplitude})
        return
    report("searching the rib frequency")
    basins = ribs_beside(coordinates, smooth, ObservedCloud(term.data), term)
    yield from (with_ribs(smooth, basin) for basin in close(basins))


def _smooth(
    coordinates: Coordinates[PeonyPetal], outline: PeonyPetal, data: Data
) -> Iterate[PeonyPetal]:
    """A petal without ribs, fitted to the data from its outline."""
    rough, uv = _with_heights(coordinates, outline, data)
    held = coordinates.holding(RIBS).around(with_values(rough, {"rib_amplitude": 0.0}))
    cloud = ObservedCloud(data)
    return minimise(held, [cloud], held.template, [cloud.at(uv)], 8, 1.0)


def _with_heights(
    coordinates: Coordinates[PeonyPetal], outline: PeonyPetal, data: Data
) -> tuple[PeonyPetal, Float[np.ndarray, "n 2"]]:
    """The petal with heights fitted to the data, and foot points straight below the data."""
    heights = Heights.of(outline, coordinates.free, data)
    if not heights.names:
        return outline, heights.uv
    weights = data.weights
    amplitudes = fit_amplitudes(heights.above, heights.basis, weights)
    return with_values(outline, dict(zip(heights.names, amplitudes, strict=True))), heights.uv
