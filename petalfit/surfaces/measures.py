"""Measures of a sheet that people publish: lengths along the surface, area, and how much it is bent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.surfaces.map import Domain

# Nodes across and along. A side's polygon is shorter than its curve by (bend per segment)²/24.
SHAPE = (129, 81)


class Measures(NamedTuple):
    """Measures of sheets whose midrib is the line in the middle of u, from its base to its tip along v.

    Attributes:
        length: Arc length of the midrib.
        width: The greatest distance between the margins, measured along the surface at right angles to
            the lines of constant u.
        width_at: Where that is: the arc length from the base, as a fraction of the length.
        area: Area of one face.
        perimeter: Length of the whole margin.
        chord: Straight distance from base to tip.
        bend: ∫ κₙ ds along the midrib, in rad: the angle between the directions of base and tip if the
            midrib does not bend sideways; positive towards the normal's side.
        cup: The same along the line of constant v at half the length, from margin to margin.
        twist: ∫ τ ds along the midrib, in rad, with τ the rate at which the surface turns about it.
    """

    length: Float[np.ndarray, " k"]
    width: Float[np.ndarray, " k"]
    width_at: Float[np.ndarray, " k"]
    area: Float[np.ndarray, " k"]
    perimeter: Float[np.ndarray, " k"]
    chord: Float[np.ndarray, " k"]
    bend: Float[np.ndarray, " k"]
    cup: Float[np.ndarray, " k"]
    twist: Float[np.ndarray, " k"]


def nodes(domain: Domain) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
    """The u and v of the nodes at which `measures` needs positions."""
    u, v = (np.linspace(*side, count) for side, count in zip(domain, SHAPE, strict=True))
    u, v = np.meshgrid(u, v, indexing="ij")
    return u, v


def measures(grids: Float[np.ndarray, "k m n 3"], orientation: float = 1.0) -> Measures:
    """Measures sheets, given their positions at `nodes`.

    Args:
        grids: The positions on k sheets, at these nodes or at every second of them.
        orientation: The sign of the normal ∂S/∂u × ∂S/∂v on the upper side.
    """
    rows, columns = np.diff(grids, axis=1), np.diff(grids, axis=2)
    across, along = _norm(rows), _norm(columns)
    middle = grids.shape[1] // 2
    midrib, stretch = grids[:, middle], along[:, middle]
    run = np.concatenate([np.zeros((len(grids), 1)), np.cumsum(stretch, axis=1)], axis=1)
    length = run[:, -1]
    # The parts of the steps across that are at right angles to the lines along the sheet.
    ahead = _unit(np.gradient(grids, axis=2))
    ahead = _unit(ahead[:, 1:] + ahead[:, :-1])
    square = rows - ahead * np.sum(rows * ahead, axis=-1, keepdims=True)
    widths = np.sum(_norm(square), axis=1)
    peak = _peak(widths)
    normal = orientation * _unit(np.cross(np.gradient(grids, axis=1), np.gradient(grids, axis=2)))
    turns = np.sum(np.diff(_unit(columns[:, middle]), axis=1) * normal[:, middle, 1:-1], axis=-1)
    cups = np.sum(np.diff(_unit(rows), axis=1) * normal[:, 1:-1], axis=-1)
    direction = _unit(np.gradient(midrib, axis=1))
    sideways = grids[:, middle + 1] - grids[:, middle - 1]
    sideways = _unit(sideways - direction * np.sum(sideways * direction, axis=-1, keepdims=True))
    up = 0.5 * (normal[:, middle, 1:] + normal[:, middle, :-1])
    diagonals = (
        grids[:, 1:, 1:] - grids[:, :-1, :-1],
        grids[:, 1:, :-1] - grids[:, :-1, 1:],
    )
    cup = _integral(cups)
    half = [np.interp(0.5 * x[-1], x, turn) for x, turn in zip(run, cup, strict=True)]
    return Measures(
        length=length,
        width=_at(widths, *peak),
        width_at=_at(run, *peak) / length,
        area=0.5 * np.sum(_norm(np.cross(*diagonals)), axis=(1, 2)),
        perimeter=np.sum(across[:, :, 0] + across[:, :, -1], axis=1)
        + np.sum(along[:, 0] + along[:, -1], axis=1),
        chord=_norm(midrib[:, -1] - midrib[:, 0]),
        bend=_integral(turns),
        cup=np.array(half),
        twist=np.sum(np.diff(sideways, axis=1) * up, axis=(1, 2)),
    )


def _norm(x: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
    return np.linalg.norm(x, axis=-1)


def _unit(x: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    return x / np.maximum(_norm(x), 1e-300)[..., None]


def _integral(turns: Float[np.ndarray, "k n ..."]) -> Float[np.ndarray, "k ..."]:
    """The sum of the turns between segments, with half a turn for the rest of either end segment."""
    return np.sum(turns, axis=1) + 0.5 * (turns[:, 0] + turns[:, -1])


def _peak(values: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
    """The index of the greatest value, and how far the peak of a parabola lies from it, in steps.

    At either end of the values the peak is the end itself.
    """
    place, last = np.argmax(values, axis=1), values.shape[1] - 1
    before, here, after = (_taken(values, np.clip(place + k, 0, last)) for k in (-1, 0, 1))
    bent = before - 2 * here + after
    part = 0.5 * (before - after) / np.where(bent < 0, bent, -1.0)
    return place, np.where((place > 0) & (place < last), part, 0.0)


def _at(
    values: Float[np.ndarray, "k n"], place: np.ndarray, part: np.ndarray
) -> Float[np.ndarray, " k"]:
    """The parabola through three values around a place, `part` steps from it."""
    last = values.shape[1] - 1
    before, here, after = (_taken(values, np.clip(place + k, 0, last)) for k in (-1, 0, 1))
    return here + 0.5 * part * (after - before) + 0.5 * part**2 * (before - 2 * here + after)


def _taken(values: Float[np.ndarray, "k n"], place: np.ndarray) -> Float[np.ndarray, " k"]:
    return np.take_along_axis(values, place[:, None], axis=1)[:, 0]
