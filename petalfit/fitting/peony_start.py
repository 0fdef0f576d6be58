"""Where to start a peony petal in a known pose: outline first, then heights, then ribs.

The outline is a function of a_x, b_y and c alone, and the height above the plane is linear in the
amplitudes once (u, v) are known. What is left is the rib frequency, whose cost has many basins: a
periodogram of the residual heights finds them all at once.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from petalfit.components import PeonyPetal, parameters
from petalfit.fitting import programs
from petalfit.fitting.coordinates import Coordinates, Numbers, evenly_spread, with_values
from petalfit.residuals import Data

OUTLINE = ("a_x", "b_y", "c")
HEIGHTS = ("c_z", "dx", "dy", "midrib_height", "tip_curl")
RIBS = ("rib_frequency", "rib_amplitude")
BASINS = 3

# Directions of half a circle: of the other half support functions are the same, where x = 0 is a mirror.
_DIRECTIONS = np.pi * (np.arange(17) / 16 - 0.5)
_SHARES = np.array([1, *15 * [2], 1]) / 32
_BATCH = 256
_GENERATIONS = (4, 1, 1, 1, 1)  # batches
# Mean score of a direction: of whole petals at most 0.4, without their tip at least 1.7.
_COMPLETE = 1.0
FREQUENCIES = np.arange(2.0, 56.0, 0.25)

_TYPICAL = {name: parameters(PeonyPetal)[name].typical for name in OUTLINE}
_LOW, _HIGH = np.array(list(_TYPICAL.values())).T
_BOUNDS = np.array([parameters(PeonyPetal)[name].bounds for name in OUTLINE]).T
_EDGE = np.linspace(-0.5, 0.5, 25)
_OUTLINE_UV = np.concatenate(
    [
        np.stack([_EDGE, np.zeros(25)], -1),
        np.stack([_EDGE, np.ones(25)], -1),
        np.stack([np.full(25, 0.5), _EDGE + 0.5], -1),
    ]
)


def flat(petal: PeonyPetal) -> PeonyPetal:
    """The petal with nothing rising from the plane z = 0."""
    return with_values(petal, dict.fromkeys((*HEIGHTS, "rib_amplitude"), 0.0))


class OutlineSearch(NamedTuple):
    """Candidates for a_x, b_y and c: those that are not free keep the petal's values.

    Attributes:
        plane: The petal with nothing rising from the plane.
        given: Its values.
        moves: Which of them are free.
    """

    plane: PeonyPetal
    given: Float[np.ndarray, "3"]
    moves: Bool[np.ndarray, "3"]

    @classmethod
    def of(cls, petal: PeonyPetal, free: Collection[str]) -> OutlineSearch:
        """Of a petal's outline."""
        given = np.array([float(getattr(petal, name)) for name in OUTLINE])
        return cls(flat(petal), given, np.isin(OUTLINE, [*free]))

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """Of the typical ranges."""
        return np.where(self.moves, 0.5 * (_LOW + _HIGH), self.given)

    def around(
        self, values: Float[np.ndarray, "3"], part: float, batches: int, others: int = 0
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k others"]]:
        """Values evenly spread over a part of the typical ranges, and so many other numbers in (0, 1)."""
        evenly = evenly_spread(batches * _BATCH, 3 + others)
        spread = self.moves * (_HIGH - _LOW) * part
        return np.clip(values + spread * (evenly[:, :3] - 0.5), *_BOUNDS), evenly[:, 3:]

    def edges(self, values: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k m 2"]:
        """Places along the outlines."""
        outlines = [
            _repeated(self.plane, dict(zip(OUTLINE, batch.T, strict=True)))
            for batch in np.split(values, len(values) // _BATCH)
        ]
        places = [np.asarray(programs.positions(batch, _OUTLINE_UV)) for batch in outlines]
        return np.concatenate(places)[..., :2]


def fit_outline(
    petal: PeonyPetal,
    free: Collection[str],
    points: Float[np.ndarray, "n 3"],
) -> tuple[PeonyPetal, bool]:
    """The petal with the a_x, b_y and c whose outline has the support function of the points' x and y.

    And whether it has: if not, a part of the petal without which the outline is another is missing.

    Petals are symmetric about x = 0 (but for their scallops), so points are reflected there: half a
    petal shows the whole outline. A heavy-tailed score lets a missing part be missing. Evenly spread
    candidates over the typical ranges, then generations of them around the best.
    """
    directions = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])

    def along(xy: np.ndarray) -> np.ndarray:
        return np.stack([np.abs(xy[..., 0]), xy[..., 1]], axis=-1) @ directions

    # The farthest few of the points may be strays.
    target = np.sort(along(points), axis=0)[-(1 + len(points) // 128)]
    tolerance = 0.01 * np.max(np.abs(target))
    search, score = OutlineSearch.of(petal, free), np.inf
    best = search.middle
    for k, batches in enumerate(_GENERATIONS):
        candidates, _ = search.around(best, 0.3**k, batches)
        gap = (np.max(along(search.edges(candidates)), axis=1) - target) / tolerance
        scores = np.log1p(gap**2) @ _SHARES
        best, score = candidates[np.argmin(scores)], np.min(scores)
    return with_values(petal, dict(zip(OUTLINE, best, strict=True))), bool(score < _COMPLETE)


def _repeated(petal: PeonyPetal, values: dict[str, np.ndarray]) -> PeonyPetal:
    """A batch of petals that differ in the given values."""
    same = {name: np.full(_BATCH, float(value)) for name, value in vars(petal).items()}
    return with_values(petal, same | values)


def straight_below(petal: PeonyPetal, points: Float[Numbers, "n 3"]) -> Float[Array, "n 2"]:
    """(u, v) of a petal straight below or above the points."""
    plane = flat(petal)
    below = np.asarray(points) * np.array([1.0, 1.0, 0.0])
    return programs.refine(plane, below, programs.nearest(plane, below), 6)


class Heights(NamedTuple):
    """How high points lie above a petal's plane, and what parameters could raise it.

    Attributes:
        names: The amplitudes that are free.
        basis: The height that a unit of each gives at every point's place, shape (n, k).
        above: Of the points.
        uv: Their places, straight below.
    """

    names: tuple[str, ...]
    basis: Float[np.ndarray, "n k"]
    above: Float[np.ndarray, " n"]
    uv: Float[Array, "n 2"]

    @classmethod
    def of(cls, petal: PeonyPetal, free: Collection[str], data: Data) -> Heights:
        """Above a petal's plane, whatever its amplitudes."""
        names = tuple(name for name in HEIGHTS if name in free)
        plane = with_values(petal, dict.fromkeys((*names, "rib_amplitude"), 0.0))
        uv = straight_below(plane, data.points)
        here = Coordinates.of(plane, names)
        t = here.inverse(plane)
        seen = programs.survey(here, data, t, uv)
        # Straight above its foot a point has the distance n_z (z - S_z), S_z linear in the heights.
        n_z = np.asarray(seen.normal)[:, 2]
        n_z = np.where(np.abs(n_z) > 1e-3, n_z, np.inf)
        basis = -np.asarray(seen.slopes) / here.slopes(t) / n_z[:, None]
        return cls(names, basis, np.asarray(seen.distance) / n_z, uv)


def fit_amplitudes(
    heights: Float[np.ndarray, " n"],
    basis: Float[np.ndarray, "n k"],
    weights: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " k"]:
    """Robust linear least squares of the heights."""
    amplitudes = np.zeros(basis.shape[1])
    for _ in range(5):
        residual = heights - basis @ amplitudes
        scale = np.sum(weights * np.abs(residual)) / np.sum(weights) + 1e-300
        root = np.sqrt(weights / (1 + (residual / scale) ** 2))
        amplitudes = np.linalg.lstsq(root[:, None] * basis, root * heights)[0]
    return amplitudes


class RibBasin(NamedTuple):
    """A peak of the periodogram.

    Attributes:
        frequency: rib_frequency there.
        amplitude: Its rib_amplitude by linear least squares.
        gain: How much it lowers χ².
    """

    frequency: float
    amplitude: float
    gain: float


# Rivals of the best rib frequency are followed if the periodogram prefers it by less than this in χ².
_CLEAR_LEAD = 50.0


def close(basins: list[RibBasin]) -> list[RibBasin]:
    """The best of them, which is the first, and its rivals."""
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
        frequency: The only one to look at, if it is known.
        distance: Normal distances of the cloud to the petal.
        slope: How much of a height the distance is: the normal's part along the petal's z axis.
        weights: Weight of every point.
        uv: Foot points.
        slopes: Of the distance, by the petal's other parameters, which are free to follow.

    Returns:
        From one to `BASINS` peaks.
    """
    # The midrib's flanks are steep: there a small shift of u is a large distance.
    scale = np.sum(weights * np.abs(distance)) / np.sum(weights) + 1e-300
    robust = weights / (1 + (distance / (3 * scale)) ** 2)
    frequencies = FREQUENCIES if frequency is None else np.array([frequency])
    root = np.sqrt(robust)
    waves, rest = root * slope * rib_waves(uv, frequencies), root * distance
    # What the other parameters can explain is not for the ribs to explain.
    basis = np.linalg.qr(root[:, None] * slopes)[0]
    waves, rest = waves - (waves @ basis) @ basis.T, rest - basis @ (basis.T @ rest)
    covariance, power = waves @ rest, np.sum(waves**2, axis=1) + 1e-300
    left = np.sum(rest**2) - np.max(covariance**2 / power)
    variance = max(left / np.sum(robust), 1e-300)
    return rib_basins(frequencies, covariance, power, variance)


def rib_waves(
    uv: Float[np.ndarray, "n 2"], frequencies: Float[np.ndarray, " f"]
) -> Float[np.ndarray, "f n"]:
    """Heights of ribs of amplitude 1, Eq. 8."""
    u, v = uv.T
    envelope = (1 - 2 * np.abs(v - 0.5)) * (1 - 2 * np.abs(u))
    return envelope * np.sin(np.outer(frequencies, (u + 0.5) * np.pi))


def rib_basins(
    frequencies: Float[np.ndarray, " f"],
    covariance: Float[np.ndarray, " f"],
    power: Float[np.ndarray, " f"],
    variance: float,
) -> list[RibBasin]:
    """Peaks of a periodogram, the best first, from one to `BASINS`.

    Args:
        frequencies: At even distances, or a single one.
        covariance: Of the ribs with what they are to explain.
        power: Of the ribs.
        variance: Of the noise, in whose units the gain is.
    """
    amplitude, gain = covariance / power, covariance**2 / power
    before, after = np.append(0.0, gain[:-1]), np.append(gain[1:], 0.0)
    peaks = np.flatnonzero((gain >= before) & (gain > after))
    # Where no distance is left to explain there is no peak, and any frequency will do.
    peaks = peaks[np.argsort(-gain[peaks])][:BASINS] if len(peaks) else [int(np.argmax(gain))]
    # The vertex of a parabola through a peak and its neighbours.
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
