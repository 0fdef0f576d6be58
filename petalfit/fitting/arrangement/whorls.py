"""Whorls and spirals: which regular arrangement the azimuths and distances of petals show."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.results import Layout, LayoutKind, Quantity, Whorl

_LEAST = 0.02  # rad; azimuths are not known better
_REGULAR = 0.4  # scatter of the azimuths, by that of random ones, below which they are regular
CLEARLY = 6.0  # difference in BIC from the next arrangement
_ANGLES = 720  # divergences that are tried
UNKNOWN = Quantity(0.0, math.inf)


class Arranged(NamedTuple):
    """The layout of petals about an axis.

    Attributes:
        layout: The layout.
        order: The petals in its order: the outermost first, and in a whorl by their angle.
        bic: Its information criterion, by which axes are compared; infinite without a regular layout.
    """

    layout: Layout
    order: Int[np.ndarray, " k"]
    bic: float


class _Guess(NamedTuple):
    """An arrangement with its evidence.

    Attributes:
        bic: Its information criterion, up to a constant.
        scatter: Root mean square difference of the azimuths from it, in rad.
        random: What that would be for petals at random azimuths.
        rings: The petals of each ring, by their angle; a single one for a spiral.
        divergence: The angle from petal to petal of a spiral, or None.
    """

    bic: float
    scatter: float
    random: float
    rings: tuple[tuple[int, ...], ...]
    divergence: float | None


def arranged(
    azimuth: Float[np.ndarray, " k"],
    radius: Float[np.ndarray, " k"],
    opening: Float[np.ndarray, " k"],
    height: Float[np.ndarray, " k"],
    axis_stderr: float,
) -> Arranged:
    """The layout of petals about an axis.

    Args:
        azimuth: Their angles about the flower's axis, in rad.
        radius: Their distances from the axis, which tell outer from inner ones.
        opening: Their angles to the axis, in rad.
        height: The heights of their bases along the axis.
        axis_stderr: Standard error of the axis's direction, in rad.
    """
    count, outside = len(azimuth), np.argsort(-radius, kind="stable")
    unknown = Layout(LayoutKind.NOT_DETERMINED, (), UNKNOWN, axis_stderr)
    if count < 3:
        return Arranged(unknown, outside, math.inf)
    guesses = [
        _whorls(azimuth, radius, outside, rings) for rings in range(1, count // 2 + 1)
        if count % rings == 0
    ]  # fmt: skip
    guesses.append(_spiral(azimuth, radius, outside))
    ranked = sorted(guesses, key=lambda guess: guess.bic)
    best = ranked[0]
    if best.divergence is None:
        # More rings than the petals clearly show are none.
        near = [g for g in ranked if g.divergence is None and g.bic < best.bic + CLEARLY]
        best = min(near, key=lambda guess: len(guess.rings))
        if len(best.rings) == 1:
            # A spiral that comes back to its first petal is the same ring.
            ranked = [guess for guess in ranked if not _closes(guess, count)]
    others = [guess for guess in ranked if guess is not best]
    clear = not others or others[0].bic - best.bic > CLEARLY
    kinds_agree = others and (others[0].divergence is None) == (best.divergence is None)
    if best.scatter > _REGULAR * best.random or not (clear or kinds_agree):
        return Arranged(unknown, outside, math.inf)
    error = best.scatter / math.sqrt(count)
    if best.divergence is not None:
        divergence = Quantity(best.divergence, _error_of_divergence(best, count))
        layout = Layout(LayoutKind.SPIRAL, (), divergence, axis_stderr)
        return Arranged(layout, outside, best.bic)
    order = np.array([k for ring in best.rings for k in ring])
    place = {int(k): number for number, k in enumerate(order)}
    whorls = tuple(
        Whorl(
            tuple(place[k] for k in ring),
            Quantity(float(azimuth[ring[0]] % (2 * math.pi)), error * math.sqrt(len(best.rings))),
            _mean(opening[list(ring)]),
            _mean(height[list(ring)]),
        )
        for ring in best.rings
    )
    layout = Layout(LayoutKind.WHORLS, whorls, _between(whorls, error), axis_stderr)
    return Arranged(layout, order, best.bic)


def _closes(guess: _Guess, count: int) -> bool:
    """Whether a spiral makes whole turns with all of its petals, as far as they show."""
    if guess.divergence is None:
        return False
    left = math.remainder(count * guess.divergence, 2 * math.pi)
    return abs(left) < count * max(2 * _error_of_divergence(guess, count), _LEAST)


def _error_of_divergence(guess: _Guess, count: int) -> float:
    """The standard error of a spiral's divergence, which is the slope of the azimuths."""
    return guess.scatter * math.sqrt(12 / count**3)


def _mean(values: Float[np.ndarray, " k"]) -> Quantity:
    if len(values) < 2:
        return Quantity(float(values.mean()), math.inf)
    return Quantity(float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values))))


def _between(whorls: tuple[Whorl, ...], error: float) -> Quantity:
    """The angle from the outermost whorl to the next one, at most the distance of two petals."""
    if len(whorls) < 2:
        return UNKNOWN
    one, other, *_ = whorls
    turn = (other.phase.value - one.phase.value) % (2 * math.pi / one.count)
    return Quantity(turn, math.sqrt(2 * len(whorls)) * error)


def _bic(squares: float, count: int, parameters: int, within: float) -> float:
    """The criterion for differences of azimuths, and for distances about the means of rings."""
    floor = count * _LEAST**2
    return (
        count * math.log(max(squares, floor) / count)
        + count * math.log(max(within, 1e-4))
        + parameters * math.log(count)
    )


def _whorls(
    azimuth: Float[np.ndarray, " k"],
    radius: Float[np.ndarray, " k"],
    outside: Int[np.ndarray, " k"],
    rings: int,
) -> _Guess:
    """Rings of equally many petals, from outside to inside."""
    count, each = len(azimuth), len(azimuth) // rings
    squares, within, found = 0.0, 0.0, []
    for ring in outside.reshape(rings, each):
        ring = ring[np.argsort(azimuth[ring] % (2 * math.pi), kind="stable")]
        off = azimuth[ring] - 2 * math.pi * np.arange(each) / each
        phase = np.angle(np.mean(np.exp(1j * off)))
        squares += float(np.sum(np.angle(np.exp(1j * (off - phase))) ** 2))
        within += float(np.sum((radius[ring] - radius[ring].mean()) ** 2))
        found.append(tuple(ring.tolist()))
    within /= count * float(radius.mean()) ** 2
    bic = _bic(squares, count, 2 * rings, within)
    random = 2 * math.pi / each / math.sqrt(12)
    return _Guess(bic, math.sqrt(squares / count), random, tuple(found), None)


def _spiral(
    azimuth: Float[np.ndarray, " k"],
    radius: Float[np.ndarray, " k"],
    outside: Int[np.ndarray, " k"],
) -> _Guess:
    """One spiral, in which every petal is turned from the one outside it by the same angle."""
    count = len(azimuth)
    step = np.arange(count)
    turns = math.pi * np.arange(-_ANGLES, _ANGLES + 1) / _ANGLES
    off = azimuth[outside] - turns[:, None] * step
    off = np.angle(np.exp(1j * (off - np.angle(np.mean(np.exp(1j * off), axis=1))[:, None])))
    squares = np.sum(off**2, axis=1)
    best = int(np.argmin(squares))
    slope = np.polyfit(step, radius[outside], 1)
    within = np.sum((radius[outside] - np.polyval(slope, step)) ** 2)
    within = float(within) / (count * float(radius.mean()) ** 2)
    bic = _bic(float(squares[best]), count, 4, within)
    scatter = math.sqrt(float(squares[best]) / count)
    order = (tuple(outside.tolist()),)
    return _Guess(bic, scatter, math.pi / math.sqrt(3), order, abs(float(turns[best])))
