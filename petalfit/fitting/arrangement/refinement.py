"""The axis of a flower that makes the arrangement of its petals the most regular."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from petalfit.fitting.arrangement.axis import Axis, Placed, axes_of, wrapped
from petalfit.fitting.arrangement.whorls import CLEARLY, Arranged, Pattern, arranged

_ASIDE, _WAYS = 0.1, 8  # rad, by which other axes are turned, and in how many directions
_TURNS = [
    _ASIDE * np.array([np.cos(turn), np.sin(turn), 0.0, 0.0])
    for turn in 2 * np.pi * np.arange(_WAYS) / _WAYS
]
_NUMBERS = 4  # of an axis: two turns, two shifts
_FARTHEST = 0.5  # in rad, and in mean distances of petals from the axis


def regular_axis(placed: Placed) -> tuple[Axis, Arranged]:
    """The axis about which petals stand the most regularly, and how they do.

    An axis is corrected by the regular arrangement that it shows. If it is too far off to show any, one
    beside it may do so.
    """
    best, *others = [_corrected(placed, axis) for axis in axes_of(placed)]
    axis, _ = others[-1]
    others += [_corrected(placed, axis.moved(turn)) for turn in _TURNS]
    likeliest = min(others, key=lambda guess: guess[1].bic)
    return likeliest if likeliest[1].bic < best[1].bic - CLEARLY else best


def _corrected(placed: Placed, axis: Axis) -> tuple[Axis, Arranged]:
    """An axis corrected by the arrangement of petals about it, if that makes them more regular."""
    found = arranged(axis.about(placed), axis.stderr)
    if found.pattern is None:
        return axis, found
    better = refined(placed, axis, found.pattern)
    again = arranged(better.about(placed), better.stderr)
    return (better, again) if again.bic <= found.bic else (axis, found)


def refined(placed: Placed, axis: Axis, pattern: Pattern) -> Axis:
    """The axis about which petals stand most regularly, near a given one.

    Azimuths of an arrangement are regular, and so are, within a whorl or along a spiral, the distances
    of the petals from the axis and their inclinations to it.

    Args:
        placed: The places of the petals.
        axis: The axis near which the search begins.
        pattern: The arrangement of the petals about that axis.

    Returns:
        The axis; the given one if there are too few petals to tell.
    """
    before = axis.about(placed)
    count, unit, slant = len(placed.base), float(before.radius.mean()), np.sin(before.inclination)

    def residuals(by: Float[np.ndarray, "4"]) -> Float[np.ndarray, " m"]:
        about = axis.moved(by * [1.0, 1.0, unit, unit]).about(placed)
        parts = [
            _beside(wrapped(about.azimuth - pattern.azimuth), pattern.phases) * slant,
            _beside(about.inclination, pattern.trend),
            _beside(about.radius / unit, pattern.trend),
        ]
        return np.concatenate(parts)

    freedom = 3 * count - pattern.phases.shape[1] - 2 * pattern.trend.shape[1] - _NUMBERS
    if freedom < 1:
        return axis
    found = least_squares(residuals, np.zeros(_NUMBERS), bounds=(-_FARTHEST, _FARTHEST))
    if np.any(np.abs(found.x) > 0.99 * _FARTHEST):
        return axis
    variance = 2 * found.cost / freedom * np.linalg.pinv(found.jac.T @ found.jac)
    stderr = math.sqrt(float(variance[0, 0] + variance[1, 1]))
    return axis.moved(found.x * [1.0, 1.0, unit, unit])._replace(stderr=stderr)


def _beside(
    values: Float[np.ndarray, " k"], columns: Float[np.ndarray, "k p"]
) -> Float[np.ndarray, " k"]:
    """What no combination of columns explains of some values."""
    return values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
