"""Parts of one petal that were told apart at creases or holes: they are joined if one petal fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.fit import fit
from petalfit.fitting.siblings import Petal
from petalfit.observations import TargetError
from petalfit.surfaces import AbstractSurface

# The least width of the contact of two parts, by the root of the smaller one's number of points.
_TOUCHING = 0.08
# How much less of the points the petal of both may explain than those of each, and how much larger its
# root mean square distance may be. Of two petals that touch, one petal explains half as much as two.
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
    """The petals and the labels after parts of the same petal have been joined, widest contacts first.

    No petal becomes larger than the largest segment.

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
    waiting = {pair: width for pair, width in contacts.items() if width > _TOUCHING}
    while waiting:
        pair = max(waiting, key=lambda pair: waiting[pair])
        del waiting[pair]
        both = np.flatnonzero(np.isin(labels, pair))
        if len(both) > largest or not petals.keys() >= set(pair):
            continue
        say("joining parts of a petal")
        some = points[both[rng.permutation(len(both))[:most]]]
        try:
            petal = Petal.of(pair[0], some, fit(model, some, **options))
        except TargetError:
            continue
        if not _fits(petal, [petals[part] for part in pair], noise):
            continue
        into, gone = pair
        labels = np.where(labels == gone, into, labels)
        petals[into] = petal
        del petals[gone]
        for one, other in [*waiting]:
            if gone in (one, other):
                width = waiting.pop((one, other))
                third = other if one == gone else one
                moved = (min(into, third), max(into, third))
                waiting[moved] = max(width, waiting.get(moved, 0.0))
    return [*petals.values()], labels


def _fits(petal: Petal, parts: Sequence[Petal], noise: float) -> bool:
    """Whether a petal follows its parts about as well as their own petals do."""
    enough = min(part.explained(noise) for part in parts) - _LESS
    rough = max(part.result.rms for part in parts) * _ROUGHER
    return petal.explained(noise) > enough and petal.result.rms < rough
