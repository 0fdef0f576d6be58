"""The androecium: the six kinds of stamens of the paper (2.3), which differ in joints and lengths."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from petalfit.colours import Colour
from petalfit.components import Anther, Filament, Stamen
from petalfit.flowers.flower import Series
from petalfit.flowers.phyllotaxis import Arrangement

# Distance between the axes of neighbours in a bundle, in radii of the filament: below 2, so they join.
_JOINED = 1.6
# The same distance between neighbours of different bundles: above 2, so they stay apart.
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
_SHORT = 0.65  # length of short filaments, relative to long ones
YELLOW, PALE = Colour.of("#e2b53c"), Colour.of("#e9efc9")


def stamens(
    kind: str,
    count: int | None = None,
    stamen: Stamen | None = None,
    colours: dict[str, Colour] | None = None,
) -> Series:
    """Stamens of one of six kinds, on top of the receptacle.

    - monadelphous: all filaments are joined to a tube around the pistil (mallows);
    - diadelphous: two bundles, all but one joined and one free, usually (9) + 1 (peas);
    - polyadelphous: several bundles, here five (St John's worts, citrus);
    - tetradynamous: six stamens, four long ones and two short ones outside them (crucifers);
    - didynamous: four stamens, two long and two short (mints);
    - synantherous: all anthers are joined to a tube, the filaments are free (daisies).

    Joined filaments stand closer than they are thick, so that their lower parts run into one another and
    separate further up.

    Args:
        kind: The name of the kind.
        count: The number of stamens, if the kind leaves it open; by default the usual number.
        stamen: The stamen that all are copies of; where there are two lengths, a long one.
        colours: The colours of the parts, "filament" and "anther".

    Raises:
        ValueError: The kind is none of these, or does not occur in that number.
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
    """Azimuths on a circle, and its radius; stamens join within a bundle and not between bundles."""
    gaps = np.concatenate(
        [[*[_JOINED] * (size - 1), _JOINED if closed else _APART] for size in sizes]
    )
    # The gaps are chords of a circle, whose radius a few steps of a fixed-point iteration find.
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
    # The sacs of neighbours touch at the tips; at the base filaments are three times as far apart.
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
