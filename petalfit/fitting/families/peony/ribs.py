"""Ribs of peony petals: a periodogram finds all frequencies that a cloud or an outline allows.

The cost has many basins along the rib frequency. The distances to a petal without ribs are therefore
compared with ribs of every frequency at once.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Array, Float

from petalfit.components import PeonyPetal, Posed
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.linearise import tangents_at
from petalfit.residuals import AbstractTerm, Data
from petalfit.surfaces import AbstractSurface, value_at

Surface = TypeVar("Surface", bound=AbstractSurface)
assert PeonyPetal.oscillation is not None
RIBS = PeonyPetal.oscillation.names
FREQUENCIES = np.arange(2.0, 56.0, 0.25)
_BASINS = 3


class RibBasin(NamedTuple):
    """A peak of the periodogram.

    Attributes:
        frequency: The rib_frequency of the peak.
        amplitude: The rib_amplitude at this frequency, by linear least squares.
        gain: The amount by which these ribs lower χ².
    """

    frequency: float
    amplitude: float
    gain: float


# Rivals of the best rib frequency are followed if the periodogram prefers it by less than this in χ².
_CLEAR_LEAD = 50.0


def close(basins: list[RibBasin]) -> list[RibBasin]:
    """The first basin, which is the best, and its rivals."""
    return [basin for basin in basins if basins[0].gain - basin.gain <= _CLEAR_LEAD]


def rib_periodogram(
    frequency: float | None,
    distance: Float[np.ndarray, " n"],
    slope: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"],
    uv: Float[np.ndarray, "n 2"],
    slopes: Float[np.ndarray, "n p"],
) -> list[RibBasin]:
    """Frequencies that explain best the normal distances to a petal without ribs, the best first.

    Args:
        frequency: The frequency, if it is known; None to try all.
        distance: Normal distances of the cloud from the petal.
        slope: Distance for a height of 1: the component of the normal along the petal's z axis.
        weights: Weight of every point.
        uv: Foot points.
        slopes: Derivatives of the distance with respect to the petal's other free parameters, which may
            explain a part of it.

    Returns:
        From one to three peaks.
    """
    # On the steep flanks of the midrib, a small shift of u causes a large distance: weights are robust.
    scale = np.sum(weights * np.abs(distance)) / np.sum(weights) + 1e-300
    robust = weights / (1 + (distance / (3 * scale)) ** 2)
    frequencies = FREQUENCIES if frequency is None else np.array([frequency])
    root = np.sqrt(robust)
    waves, rest = root * slope * rib_waves(uv, frequencies), root * distance
    # Distances that other parameters can explain are left out.
    basis = np.linalg.qr(root[:, None] * slopes)[0]
    waves, rest = waves - (waves @ basis) @ basis.T, rest - basis @ (basis.T @ rest)
    covariance, power = waves @ rest, np.sum(waves**2, axis=1) + 1e-300
    left = np.sum(rest**2) - np.max(covariance**2 / power)
    variance = max(left / np.sum(robust), 1e-300)
    return rib_basins(frequencies, covariance, power, variance)


def rib_waves(
    uv: Float[np.ndarray, "n 2"], frequencies: Float[np.ndarray, " f"]
) -> Float[np.ndarray, "f n"]:
    """Heights of ribs of amplitude 1 by Eq. 8, for every frequency and place."""
    u, v = uv.T
    envelope = (1 - 2 * np.abs(v - 0.5)) * (1 - 2 * np.abs(u))
    return envelope * np.sin(np.outer(frequencies, (u + 0.5) * np.pi))


def rib_basins(
    frequencies: Float[np.ndarray, " f"],
    covariance: Float[np.ndarray, " f"],
    power: Float[np.ndarray, " f"],
    variance: float,
) -> list[RibBasin]:
    """Peaks of a periodogram, the best first, from one to three.

    Args:
        frequencies: Equally spaced frequencies, or a single one.
        covariance: Scalar product of the ribs of each frequency with the distances.
        power: Sum of squares of the ribs of each frequency.
        variance: Variance of the noise, which is the unit of the gain.
    """
    amplitude, gain = covariance / power, covariance**2 / power
    before, after = np.append(0.0, gain[:-1]), np.append(gain[1:], 0.0)
    peaks = np.flatnonzero((gain >= before) & (gain > after))
    # If there is no distance to explain there is no peak, and any frequency will do.
    peaks = peaks[np.argsort(-gain[peaks])][:_BASINS] if len(peaks) else [int(np.argmax(gain))]
    # A frequency is refined to the vertex of a parabola through the peak and its neighbours.
    curvature = before + after - 2 * gain
    vertex = 0.5 * (before - after) / np.where(curvature < 0, curvature, np.inf)
    step = frequencies[1] - frequencies[0] if len(frequencies) > 1 else 0.0
    return [
        RibBasin(
            float(frequencies[k] + step * np.clip(vertex[k], -0.5, 0.5)),
            float(amplitude[k]),
            float(gain[k] / variance),
        )
        for k in peaks
    ]


def ribs_beside(
    coordinates: Coordinates[Surface],
    smooth: Surface,
    cloud: ObservedCloud,
    term: AbstractTerm | None = None,
) -> list[RibBasin]:
    """Ribs that explain the distances of a cloud from a petal without ribs, the best first."""
    held = coordinates.holding(RIBS).around(smooth)
    return explaining(held, cloud.data, cloud.match(smooth, term).uv)


def with_ribs(smooth: Surface, basin: RibBasin) -> tuple[str, Surface]:
    """A label, and the petal with the ribs of a basin added."""
    ribs = {"rib_frequency": basin.frequency, "rib_amplitude": basin.amplitude}
    return f"rib_frequency {basin.frequency:.2f}", with_values(smooth, ribs)


def explaining(
    coordinates: Coordinates, data: Data, uv: Float[Array | np.ndarray, "n 2"]
) -> list[RibBasin]:
    """Ribs that explain the distances of points from the coordinates' petal, the best first.

    Distances that the free parameters of the petal can explain are left out.
    """
    petal = coordinates.template
    seen, slopes = tangents_at(coordinates, coordinates.inverse(petal), uv)
    fixed = "rib_frequency" not in coordinates.free
    # Ribs rise along the petal's own z axis.
    up, unit = np.array([0.0, 0.0, 1.0]), 1.0
    if isinstance(petal, Posed):
        place = petal.placement
        up, unit = np.asarray(place.rotation)[:, 2], float(place.scale)
    return rib_periodogram(
        float(value_at(petal, "rib_frequency")) if fixed else None,
        seen.distance(data.points) / unit,
        seen.normal @ up,
        data.weights,
        np.asarray(uv),
        slopes[:, coordinates.active > 0],
    )
