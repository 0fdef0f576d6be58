"""Parts of one petal, told apart at creases, holes or shadows: they are joined if one petal fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from petalfit.fitting.fit import fit
from petalfit.fitting.segmentation.linkage import members_of
from petalfit.fitting.segmentation.segments import middle_size
from petalfit.fitting.siblings import Petal
from petalfit.observations import TargetError
from petalfit.surfaces import AbstractSurface

# The least width of the contact of two parts, by the root of the smaller one's number of points.
_TOUCHING = 0.08
# A smaller part than this, by the middle size, may have been cut off by the shadow of another organ, from
# one of the parts next to it; and how far these are away, by the extent of the larger of the two.
_SMALL, _NEXT, _GAP = 0.5, 2, 0.2
_SOME = 0.1  # part of its points that are as near to the other as the gap
# How much less of the points the petal of both may explain than those of each, and how much larger its
# root mean square distance may be. Of two petals that touch, one petal explains half as much as two.
# Across a gap this holds for the points of each part.
_LESS, _ROUGHER = 0.12, 1.7


def joined_parts(
    fitted: Sequence[Petal],
    points: Float[np.ndarray, "n 3"],
    labels: Int[np.ndarray, " n"],
    contacts: Mapping[tuple[int, int], float],
    noise: float,
    most: int,
    model: type[AbstractSurface] | AbstractSurface,
    options: Mapping[str, Any],
    rng: np.random.Generator,
    say: Callable[[str], None],
) -> tuple[list[Petal], Int[np.ndarray, " n"]]:
    """The petals and the labels after parts of the same petal have been joined.

    Parts with wide contacts come first, then small ones with those next to them. No petal becomes larger
    than the largest segment.

    Args:
        fitted: The petals of all segments.
        points: The points of the flower.
        labels: The segment of every point, −1 for none.
        contacts: The widths of smooth contacts of segments, the smaller label first.
        noise: Standard deviation of the points' distances from their sheets.
        most: The number of points that a petal is fitted to.
        model: The class of the petals, or a petal whose fixed parameters are kept.
        options: The options of all fits.
        rng: The generator of random choices.
        say: A function that is called with a line of text at each new fit.
    """
    petals = {petal.segment: petal for petal in fitted}
    largest = np.bincount(labels[labels >= 0], minlength=1).max()
    waiting = {pair: -gap for pair, gap in _gaps(points, labels).items()}
    waiting |= {pair: width for pair, width in contacts.items() if width > _TOUCHING}
    while waiting:
        pair = max(waiting, key=lambda pair: waiting[pair])
        width = waiting.pop(pair)
        both = np.flatnonzero(np.isin(labels, pair))
        if len(both) > largest or not petals.keys() >= set(pair):
            continue
        say("joining parts of a petal")
        some = points[both[rng.permutation(len(both))[:most]]]
        try:
            petal = Petal.of(pair[0], some, fit(model, some, **options))
        except TargetError:
            continue
        own = [petals[part] for part in pair]
        if not _fits(petal, own, noise) or (width < 0 and not _fits_each(petal, own, noise)):
            continue
        into, gone = pair
        labels = np.where(labels == gone, into, labels)
        petals[into] = petal
        del petals[gone]
        for one, other in [*waiting]:
            if gone in (one, other):
                beside = waiting.pop((one, other))
                third = other if one == gone else one
                moved = (min(into, third), max(into, third))
                waiting[moved] = max(beside, waiting.get(moved, -np.inf))
    return [*petals.values()], labels


def _gaps(
    points: Float[np.ndarray, "n 3"], labels: Int[np.ndarray, " n"]
) -> dict[tuple[int, int], float]:
    """The gaps between small segments and those next to them, the smaller label first."""
    inside = members_of(labels)
    parts = [points[part] for part in inside]
    small = _SMALL * middle_size(np.array([len(part) for part in parts]))
    trees, found = [KDTree(part) for part in parts], {}
    for number, part in enumerate(parts):
        if len(part) >= small:
            continue
        gaps = [
            np.quantile(tree.query(part)[0], _SOME) if k != number else np.inf
            for k, tree in enumerate(trees)
        ]
        for other in np.argsort(gaps)[:_NEXT].tolist():
            extent = max(np.linalg.norm(np.ptp(parts[k], axis=0)) for k in (number, other))
            if gaps[other] < _GAP * extent:
                found[min(number, other), max(number, other)] = float(gaps[other])
    return found


def _fits(petal: Petal, parts: Sequence[Petal], noise: float) -> bool:
    """Whether a petal follows its parts about as well as their own petals do."""
    enough = min(part.explained(noise) for part in parts) - _LESS
    rough = max(part.result.rms for part in parts) * _ROUGHER
    return petal.explained(noise) > enough and petal.result.rms < rough


def _fits_each(petal: Petal, parts: Sequence[Petal], noise: float) -> bool:
    """Whether a petal follows each of its parts about as well as its own petal does."""
    return all(
        petal.sheet.explained(part.points, noise) > part.explained(noise) - _LESS for part in parts
    )
