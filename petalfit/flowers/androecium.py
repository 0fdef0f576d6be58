"""The six kinds of stamens that the paper names (2.3): how they are joined, and how long each is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from petalfit.colours import Colour
from petalfit.components import Anther, Filament, Stamen
from petalfit.flowers.flower import Series
from petalfit.flowers.phyllotaxis import Arrangement

# Neighbours in a bundle, from axis to axis in radii of the filament: less than 2, so that they join.
_JOINED = 1.6
# From one bundle to the next; more than 2, so that they do not.
_APART = 4.5
_USUAL = {
    "monadelphous": 10,
    "diadelphous": 10,
    "polyadelphous": 15,
    "tetradynamous": 6,
    "didynamous": 4,
    "synantherous": 5,
}
KINDS = tuple(_USUAL)
_FIXED = ("tetradynamous", "didynamous")
_BUNDLES = 5
_SHORT = 0.65  # of the length of the long ones
YELLOW, PALE = Colour.of("#e2b53c"), Colour.of("#e9efc9")


def stamens(
    kind: str,
    count: int | None = None,
    stamen: Stamen | None = None,
    colours: dict[str, Colour] | None = None,
) -> Series:
    """Stamens of one of six kinds, on top of the receptacle.

    - monadelphous: the filaments of all are joined, in a tube around the pistil (mallows);
    - diadelphous: in two bundles, all but one joined and one free, (9) + 1 as a rule (peas);
    - polyadelphous: in several bundles, here five (St John's worts, citrus);
    - tetradynamous: six, four long ones and two short ones that stand outside (crucifers);
    - didynamous: four, two long and two short (mints);
    - synantherous: the anthers of all are joined to a tube, the filaments free (daisies).

    Joined filaments stand closer than they are thick, so that their lower parts run into one another, and
    part on their way up.

    Args:
        kind: Its name.
        count: How many, where the kind leaves it open; by default as many as is usual.
        stamen: What each is like, the long ones where there are two lengths.
        colours: By part, "filament" and "anther".

    Raises:
        ValueError: The kind is none of these, or does not come in that number.
    """
    if kind not in KINDS:
        raise ValueError(f"stamens are {', '.join(KINDS)}; received {kind!r}")
    count = _USUAL[kind] if count is None else count
    fewest = _USUAL[kind] if kind in _FIXED else 2 * _BUNDLES if kind == "polyadelphous" else 3
    if count < fewest or (kind in _FIXED and count != fewest):
        least = "exactly" if kind in _FIXED else "at least"
        raise ValueError(f"{kind} stamens are {least} {fewest}; received {count}")
    one = stamen or Stamen(Filament(a_2=0.0), Anther())
    match kind:
        case "monadelphous":
            azimuth, radius = _bundles((count,), one, closed=True)
        case "diadelphous":
            azimuth, radius = _bundles((count - 1, 1), one)
        case "polyadelphous":
            sizes = [len(part) for part in np.array_split(np.arange(count), _BUNDLES)]
            azimuth, radius = _bundles(tuple(sizes), one)
        case "tetradynamous":
            return _of_two_lengths(one, colours, np.pi / 4 + np.pi / 2 * np.arange(4), [0.0, np.pi])
        case "didynamous":
            return _of_two_lengths(one, colours, [-0.4, 0.4], [-1.1, 1.1])
        case _:
            return _with_joined_anthers(count, one, colours)
    return _series([one] * count, azimuth, colours, radius=radius, opening=0.12)


def _bundles(
    sizes: tuple[int, ...], stamen: Stamen, closed: bool = False
) -> tuple[np.ndarray, float]:
    """Azimuths on a circle, and its radius: joined within a bundle, apart between bundles."""
    gaps = np.concatenate(
        [[*[_JOINED] * (size - 1), _JOINED if closed else _APART] for size in sizes]
    )
    # Chords of a circle: its radius by a few steps of a fixed point.
    chords = gaps * float(stamen.filament.r)
    radius = chords.sum() / (2 * math.pi)
    for _ in range(50):
        radius *= np.arcsin(np.minimum(chords / (2 * radius), 1.0)).sum() / math.pi
    angles = 2 * np.arcsin(np.minimum(chords / (2 * radius), 1.0))
    return np.concatenate([[0.0], np.cumsum(angles)[:-1]]), float(radius)


def _of_two_lengths(
    stamen: Stamen, colours: dict[str, Colour] | None, long: np.ndarray | list, short: list
) -> Series:
    smaller = dataclasses.replace(
        stamen, filament=dataclasses.replace(stamen.filament, h=_SHORT * stamen.filament.h)
    )
    each = [stamen] * len(long) + [smaller] * len(short)
    apart = 4.0 * float(stamen.filament.r)
    radius = np.array([apart] * len(long) + [1.5 * apart] * len(short))
    azimuth = np.concatenate([long, short])
    return _series(each, azimuth, colours, radius=radius, opening=0.12)


def _with_joined_anthers(count: int, stamen: Stamen, colours: dict[str, Colour] | None) -> Series:
    # At the tips the sacs of neighbours touch; at the base the filaments are three times as far apart.
    tip = 0.9 * float(stamen.anther.r + stamen.anther.swell) / math.sin(math.pi / count)
    base = 3.0 * max(tip, float(stamen.filament.r) / math.sin(math.pi / count))
    lean = -math.asin(min((base - tip) / float(stamen.filament.h), 0.9))
    straight = dataclasses.replace(
        stamen, filament=dataclasses.replace(stamen.filament, a_2=0.0), tilt=lean
    )
    azimuth = 2 * np.pi * np.arange(count) / count
    return _series([straight] * count, azimuth, colours, radius=base, opening=lean)


def _series(
    each: list[Stamen],
    azimuth: np.ndarray,
    colours: dict[str, Colour] | None,
    radius: float | np.ndarray,
    opening: float,
) -> Series:
    return Series.of(
        "stamen",
        each,
        Arrangement(azimuth, np.zeros(len(each))),
        colours or {"filament": PALE, "anther": YELLOW},
        radius=radius,
        opening=opening,
    )
