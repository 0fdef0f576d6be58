"""Spirals: the order of petals along one, of which their distances from the axis tell only a part."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from petalfit.fitting.arrangement.axis import wrapped

_STEP = math.radians(0.5)  # between divergences that are tried
_PHASES = 60
_SCATTER = 0.08  # rad; the expected scatter of azimuths about a spiral
_SHUFFLED = 0.08  # the expected error of a rank by distance, in numbers of petals
_LIKELY = 40  # pairs of divergence and phase for which the best order is searched
_ROUNDS = 5


class Spiral(NamedTuple):
    """A spiral through the azimuths of some petals.

    Attributes:
        divergence: The angle from each petal to the next one inwards, in rad, of either sign.
        phase: The azimuth of the outermost petal, in rad.
        order: The petals from outside to inside.
        squares: The sum of the squared differences of the azimuths from it.
    """

    divergence: float
    phase: float
    order: Int[np.ndarray, " k"]
    squares: float


def spiral_of(azimuth: Float[np.ndarray, " k"], outside: Int[np.ndarray, " k"]) -> Spiral:
    """The spiral that is the likeliest.

    Neighbours along a spiral have almost the same distance from the axis, so that their order by distance
    is uncertain, but their azimuths are far apart. Ranks are therefore assigned by both.

    Args:
        azimuth: The azimuths of the petals, in rad.
        outside: The petals by their distance from the axis, the outermost first.
    """
    count = len(azimuth)
    ranks, place = np.arange(count), np.empty(count)
    place[outside] = ranks
    shuffled = 0.5 * ((place[:, None] - ranks) / _spread(count)) ** 2
    phases = 2 * math.pi * np.arange(_PHASES) / _PHASES
    turns = np.arange(-math.pi, math.pi, _STEP)
    # Petals may share a rank here, so that the cost is a lower bound.
    bounds = np.stack([_bounds(azimuth, shuffled, turn, phases) for turn in turns])
    best: tuple[float, Spiral] | None = None
    for number in np.argsort(bounds, axis=None)[:_LIKELY]:
        turn, phase = turns[number // _PHASES], phases[number % _PHASES]
        found = _assigned(azimuth, shuffled, float(turn), float(phase))
        if best is None or found[0] < best[0]:
            best = found
    assert best is not None
    return best[1]


def _spread(count: int) -> float:
    """The expected error of a rank by distance."""
    return max(_SHUFFLED * count, 0.5)


def _off(
    azimuth: Float[np.ndarray, " k"], turn: float, phase: Float[np.ndarray, " p"]
) -> Float[np.ndarray, "p k k"]:
    """The differences of all azimuths from those of all ranks."""
    there = turn * np.arange(len(azimuth)) + phase[:, None]
    return wrapped(azimuth[:, None] - there[:, None, :])


def _bounds(
    azimuth: Float[np.ndarray, " k"],
    shuffled: Float[np.ndarray, "k k"],
    turn: float,
    phases: Float[np.ndarray, " p"],
) -> Float[np.ndarray, " p"]:
    cost = 0.5 * (_off(azimuth, turn, phases) / _SCATTER) ** 2 + shuffled
    # Far from a spiral all azimuths are equally bad.
    return np.minimum(cost.min(axis=2), 8.0).sum(axis=1)


def _assigned(
    azimuth: Float[np.ndarray, " k"], shuffled: Float[np.ndarray, "k k"], turn: float, phase: float
) -> tuple[float, Spiral]:
    """The cost and the spiral of the best ranks near a divergence and a phase."""
    count, rank = len(azimuth), np.zeros(0, int)
    for _ in range(_ROUNDS):
        off = _off(azimuth, turn, np.array([phase]))[0]
        before, rank = rank, linear_sum_assignment(0.5 * (off / _SCATTER) ** 2 + shuffled)[1]
        if np.array_equal(rank, before):
            break
        slope, shift = np.polyfit(rank, off[np.arange(count), rank], 1)
        turn, phase = turn + float(slope), phase + float(shift)
    off = _off(azimuth, turn, np.array([phase]))[0][np.arange(count), rank]
    squares = float(off @ off)
    cost = 0.5 * squares / _SCATTER**2 + float(shuffled[np.arange(count), rank].sum())
    order = np.argsort(rank)
    return cost, Spiral(math.remainder(turn, 2 * math.pi), phase, order, squares)
