"""Ribs of a peony petal that are found in outlines, or in the clouds of a joint fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from petalfit.components import bare, parameters
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.families.peony.ribs import (
    FREQUENCIES,
    RibBasin,
    close,
    rib_basins,
    rib_waves,
    ribs_beside,
    with_ribs,
)
from petalfit.fitting.inference.identifiability import DETERMINED, typical_spread
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.linearise import contour_slopes
from petalfit.fitting.likelihood.matching import CORRELATED, View, rows, term_of_rows
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.solver.observer import report
from petalfit.residuals import places
from petalfit.surfaces import AbstractSurface, outline


def ribbed_starts(
    coordinates: Coordinates,
    held: Coordinates,
    smooth: AbstractSurface,
    clouds: Sequence[ObservedCloud],
    views: ObservedViews,
) -> Iterator[tuple[str, AbstractSurface]]:
    """Starts made from a petal without ribs, with the ribs that clouds and silhouettes show.

    Args:
        coordinates: The free parameters.
        held: The same coordinates with the ribs held.
        smooth: A petal without ribs that follows the outlines.
        clouds: All clouds of the fit.
        views: All silhouettes of the fit.
    """
    report("searching the rib frequency")
    for cloud in clouds:
        for basin in close(ribs_beside(coordinates, smooth, cloud)):
            yield with_ribs(smooth, basin)
    basins, visible = _rib_basins(held, smooth, views)
    for basin in close(basins) if visible else []:
        yield with_ribs(smooth, basin)


def _rib_basins(
    held: Coordinates, smooth: AbstractSurface, views: ObservedViews
) -> tuple[list[RibBasin], bool]:
    """Rib frequencies that explain the residuals of silhouettes best, and whether ribs would show."""
    free, t = held.free, held.inverse(smooth)
    frequencies = FREQUENCIES
    if "rib_frequency" not in free:
        frequencies = np.array([float(held.template.rib_frequency)])
    covariance, power = np.zeros((2, len(frequencies)))
    for view in views.views:
        slopes, waves, distance = _weighted(held, t, view, frequencies)
        # Distances that other parameters can follow within their typical ranges are no sign of ribs.
        inverse = np.linalg.inv(slopes.T @ slopes + np.eye(len(t)))
        distance = distance - slopes @ (inverse @ (slopes.T @ distance))
        waves = waves - (waves @ slopes) @ inverse @ slopes.T
        covariance -= waves @ distance
        power += np.sum(waves**2, axis=1)
    basins = rib_basins(frequencies, covariance, power + 1e-300, 1.0)
    (spread,) = typical_spread(("rib_amplitude",), parameters(bare(held.template)))
    return basins, bool(np.max(power) * spread**2 > DETERMINED**-2)


def _weighted(
    held: Coordinates, t: Float[np.ndarray, " p"], view: View, frequencies: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes, rib waves and distances at matched places of a view, in units of the noise."""
    smooth = held.model(t)
    match = view.matched(outline(smooth, view.contour.camera))
    noise = view.noise(match)
    root = np.sqrt(match.length * view.cauchy_weight(match, noise) / (2 * CORRELATED)) / noise
    term = term_of_rows([rows(view.contour, match, root)])
    slopes = contour_slopes(held, t, term)
    # Ribs rise along z.
    rise = term.covectors(places(smooth, term.uv))[:, 2]
    return slopes, rib_waves(match.uv, frequencies) * rise, root * match.distance
