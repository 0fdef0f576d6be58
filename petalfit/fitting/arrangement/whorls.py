"""Whorls and spirals: which regular arrangement the azimuths and distances of petals show."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.arrangement.axis import About
from petalfit.fitting.arrangement.spiral import spiral_of
from petalfit.results import Layout, LayoutKind, Quantity, Whorl

_LEAST = 0.02  # rad; azimuths are not known better
CLEARLY = 6.0  # difference in BIC from the next arrangement
UNKNOWN = Quantity(0.0, math.inf)


class Pattern(NamedTuple):
    """The regular arrangement that petals show, as far as it fixes their places.

    Attributes:
        azimuth: The azimuth of every petal in it, in rad, shape (k,).
        phases: What the numbers of the arrangement change: the azimuths may differ by any combination of
            these columns, shape (k, p).
        trend: The same for distances from the axis and inclinations.
    """

    azimuth: Float[np.ndarray, " k"]
    phases: Float[np.ndarray, "k p"]
    trend: Float[np.ndarray, "k q"]


class Arranged(NamedTuple):
    """The layout of petals about an axis.

    Attributes:
        layout: The layout.
        order: The petals in its order: the outermost first, and in a whorl by their angle.
        bic: Its information criterion, by which axes are compared; infinite without a regular layout.
        pattern: The regular arrangement; None if there is none.
    """

    layout: Layout
    order: Int[np.ndarray, " k"]
    bic: float
    pattern: Pattern | None


class _Guess(NamedTuple):
    """An arrangement with its evidence.

    Attributes:
        bic: Its information criterion.
        scatter: Root mean square difference of the azimuths from it, in rad.
        rings: The petals of each ring, by their angle; those of a spiral from outside to inside.
        divergence: The angle from petal to petal of a spiral, or None.
        pattern: The places of the petals.
    """

    bic: float
    scatter: float
    rings: tuple[tuple[int, ...], ...]
    divergence: float | None
    pattern: Pattern


def arranged(about: About, axis_stderr: float) -> Arranged:
    """The layout of petals about an axis.

    Args:
        about: How the petals stand about the axis. Their distances from it tell outer from inner ones.
        axis_stderr: Standard error of the axis's direction, in rad.
    """
    azimuth, radius = about.azimuth, about.radius
    count, outside = len(azimuth), np.argsort(-radius, kind="stable")
    layout = Layout(LayoutKind.NOT_DETERMINED, (), UNKNOWN, axis_stderr)
    unknown = Arranged(layout, outside, math.inf, None)
    if count < 3:
        return unknown
    guesses = [
        _whorls(azimuth, radius, outside, rings) for rings in range(1, count // 2 + 1)
        if count % rings == 0
    ]  # fmt: skip
    ring, spiral = guesses[0], _spiral(azimuth, radius, outside)
    if not (_closes(spiral, count) and ring.bic < spiral.bic + CLEARLY):
        guesses.append(spiral)  # otherwise it comes back to its first petal, and is the ring
    best = min(guesses, key=lambda guess: guess.bic)
    others = [g for g in guesses if (g.divergence is None) != (best.divergence is None)]
    if best.divergence is None:
        # More rings than the petals clearly show are none.
        near = [g for g in guesses if g.divergence is None and g.bic < best.bic + CLEARLY]
        best = min(near, key=lambda guess: len(guess.rings))
    if min([*(guess.bic for guess in others), _bic_of_none(radius)]) < best.bic + CLEARLY:
        return unknown
    order = np.array([k for ring in best.rings for k in ring])
    if best.divergence is not None:
        divergence = Quantity(best.divergence, _error_of_divergence(best, count))
        layout = Layout(LayoutKind.SPIRAL, (), divergence, axis_stderr)
        return Arranged(layout, order, best.bic, best.pattern)
    place = {int(k): number for number, k in enumerate(order)}
    # The rings have one phase together or one each.
    error = best.scatter * math.sqrt(best.pattern.phases.shape[1] / count)
    whorls = tuple(
        Whorl(
            tuple(place[k] for k in ring),
            Quantity(float(best.pattern.azimuth[ring[0]] % (2 * math.pi)), error),
            _mean(about.opening[list(ring)]),
            _mean(about.height[list(ring)]),
        )
        for ring in best.rings
    )
    layout = Layout(LayoutKind.WHORLS, whorls, _between(whorls, best, count), axis_stderr)
    return Arranged(layout, order, best.bic, best.pattern)


def _closes(guess: _Guess, count: int) -> bool:
    """Whether a spiral makes whole turns with all of its petals, as far as they show."""
    assert guess.divergence is not None
    left = math.remainder(count * guess.divergence, 2 * math.pi)
    return abs(left) < count * max(2 * _error_of_divergence(guess, count), _LEAST)


def _error_of_divergence(guess: _Guess, count: int) -> float:
    """The standard error of a spiral's divergence, which is the slope of the azimuths."""
    return guess.scatter * math.sqrt(12 / count**3)


def _mean(values: Float[np.ndarray, " k"]) -> Quantity:
    if len(values) < 2:
        return Quantity(float(values.mean()), math.inf)
    return Quantity(float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values))))


def _between(whorls: tuple[Whorl, ...], guess: _Guess, count: int) -> Quantity:
    """The angle from the outermost whorl to the next one, at most the distance of two petals."""
    if len(whorls) < 2:
        return UNKNOWN
    one, other, *_ = whorls
    turn = (other.phase.value - one.phase.value) % (2 * math.pi / one.count)
    return Quantity(turn, guess.scatter * math.sqrt(2 * len(whorls) / count))


def _bic(scatter: float, count: int, within: float, numbers: float) -> float:
    """The criterion of an arrangement: −2 log of the probability of the azimuths and the distances.

    Any petal may have any of its places.

    Args:
        scatter: Root mean square difference of the azimuths from it, in rad.
        count: The number of petals.
        within: The variance of the distances from the axis about those of the arrangement, by the square
            of their mean.
        numbers: The logarithm of the number of arrangements of its kind that differ by more than the
            errors of their numbers.
    """
    angles = count * math.log(2 * math.pi * math.e * scatter**2)
    return angles + count * math.log(max(within, 1e-4)) + 2 * (math.lgamma(count + 1) + numbers)


def _bic_of_none(radius: Float[np.ndarray, " k"]) -> float:
    """The criterion of petals at random azimuths, whose distances are about one mean."""
    count, within = len(radius), float(radius.var() / radius.mean() ** 2)
    turns = 2 * count * math.log(2 * math.pi)
    return turns + count * math.log(max(within, 1e-4)) + math.log(count)


def _scatter(squares: float, freedom: int) -> float:
    return max(math.sqrt(squares / max(freedom, 1)), _LEAST)


def _whorls(
    azimuth: Float[np.ndarray, " k"],
    radius: Float[np.ndarray, " k"],
    outside: Int[np.ndarray, " k"],
    rings: int,
) -> _Guess:
    """Rings of equally many petals, from outside to inside.

    Each ring stands in the gaps of the one before, as whorls of flowers usually do, or anywhere.
    """
    count, each = len(azimuth), len(azimuth) // rings
    off, within, found = np.zeros((rings, each)), 0.0, []
    for number, ring in enumerate(outside.reshape(rings, each)):
        ring = ring[np.argsort(azimuth[ring] % (2 * math.pi), kind="stable")]
        off[number] = azimuth[ring] - 2 * math.pi * np.arange(each) / each
        within += float(np.sum((radius[ring] - radius[ring].mean()) ** 2))
        found.append(tuple(ring.tolist()))
    within /= (count - rings) * float(radius.mean()) ** 2
    own = np.angle(np.mean(np.exp(1j * off), axis=1))
    gaps = math.pi / each * np.arange(rings)
    # All rings together have one phase; each may begin with any of its petals.
    common = gaps + np.angle(np.mean(np.exp(1j * each * (own - gaps)))) / each
    common = common + 2 * math.pi / each * np.round((own - common) * each / (2 * math.pi))
    each_ring = np.zeros((count, rings))
    for number, ring in enumerate(found):
        each_ring[list(ring), number] = 1.0
    guesses = []
    for phases, phase in ((1, common), (rings, own)):
        places = np.empty(count)
        turns = phase[:, None] + 2 * math.pi * np.arange(each) / each
        places[np.concatenate(found)] = turns.ravel()
        pattern = Pattern(places, each_ring if phases > 1 else np.ones((count, 1)), each_ring)
        squares = float(np.sum(np.angle(np.exp(1j * (off - phase[:, None]))) ** 2))
        scatter = _scatter(squares, count - phases)
        numbers = phases * math.log(2 * math.pi / each * math.sqrt(count / phases) / scatter)
        bic = _bic(scatter, count, within, numbers) + rings * math.log(count)
        guesses.append(_Guess(bic, scatter, tuple(found), None, pattern))
    return min(guesses, key=lambda guess: guess.bic)


def _spiral(
    azimuth: Float[np.ndarray, " k"],
    radius: Float[np.ndarray, " k"],
    outside: Int[np.ndarray, " k"],
) -> _Guess:
    """One spiral, in which every petal is turned from the one outside it by the same angle."""
    count, found = len(azimuth), spiral_of(azimuth, outside)
    step, distance = np.arange(count), radius[found.order]
    within = np.sum((distance - np.polyval(np.polyfit(step, distance, 1), step)) ** 2)
    within = float(within) / (max(count - 2, 1) * float(radius.mean()) ** 2)
    scatter = _scatter(found.squares, count - 2)
    order = (tuple(found.order.tolist()),)
    rank = np.argsort(found.order)
    along = np.stack([np.ones(count), rank], axis=-1)
    pattern = Pattern(found.phase + found.divergence * rank, along, along)
    guess = _Guess(0.0, scatter, order, abs(found.divergence), pattern)
    phases = 2 * math.pi * math.sqrt(count) / scatter
    turns = 2 * math.pi / _error_of_divergence(guess, count)
    numbers = math.log(phases) + math.log(turns)
    bic = _bic(scatter, count, within, numbers)
    return guess._replace(bic=bic + 2 * math.log(count))
