"""The segments of a cloud: the points of each sheet, found without a model of the sheets."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.segmentation.linkage import contact_widths, facets, joined, moved, renumbered
from petalfit.fitting.segmentation.neighbours import COUNT, Neighbours
from petalfit.fitting.segmentation.pairs import Pairs
from petalfit.fitting.segmentation.planes import tangent_planes
from petalfit.fitting.segmentation.quadrics import Quadrics
from petalfit.fitting.segmentation.waists import cut_at_waists, narrowest_waist

FEWEST = 20 * COUNT
_GUESS = 0.3  # noise to begin with, in median distances to the nearest neighbour
_EXACT = 0.1  # least noise, in the same; sheets without any are not followed more closely
_CONTACT = 0.38  # a contact of this relative width is one within a sheet
_WAIST = 0.33  # a waist below this relative width is one between two sheets
_NEARLY = 0.25  # relative difference from these widths at which another number of sheets is a rival
_FIRST = 20  # points of the smallest facets that are joined
_LEAST = 0.008  # smallest share of all points that a segment has
_PART = 0.03  # smallest share of all points that a part has which is cut off at a waist
_ROUNDS = 3


@dataclasses.dataclass(frozen=True)
class Segments:
    """The segments of a cloud.

    Attributes:
        labels: The segment of every point, −1 for none, shape (n,).
        noise: Standard deviation of the points' distances from their sheets.
        rivals: Other numbers of segments that the evidence hardly excludes.
        thickness: The noise in median radii of neighbourhoods: 0.3 where points fill space.
    """

    labels: Int[np.ndarray, " n"]
    noise: float
    rivals: tuple[int, ...]
    thickness: float

    @property
    def count(self) -> int:
        """The number of segments."""
        return int(self.labels.max(initial=-1)) + 1


def segments_of(
    points: Float[np.ndarray, "n 3"], count: int | None = None, seed: int = 0
) -> Segments:
    """Finds the segments of a cloud of several sheets, which may wrap and touch each other.

    Near points are compared by their tangent planes and by quadrics through their neighbours. Facets grow
    from the pairs that agree; they end at creases, at edges and where sheets touch. Facets with a wide
    smooth contact are then joined to segments, and segments are cut where they have a narrow waist.

    Args:
        points: Shape (n, 3), at least `FEWEST`.
        count: The number of segments, if it is known.
        seed: The seed of random choices; the result hardly depends on it.
    """
    near = Neighbours.of(points)
    planes = tangent_planes(near, noise := _GUESS * float(np.median(near.distance[:, 0])), seed)
    for _ in range(2):
        noise = max(
            Quadrics.of(near, planes, noise).noise(), _EXACT * float(np.median(near.distance[:, 0]))
        )
    pairs = Pairs.of(near, Quadrics.of(near, planes, noise), noise)
    labels, few, least = facets(pairs, len(points)), float(_FIRST), _LEAST * len(points)
    for _ in range(_ROUNDS):
        labels = joined(moved(labels, pairs, few), pairs, _CONTACT)
        few = max(least, float(_FIRST))
        labels = cut_at_waists(labels, pairs, _WAIST, _PART * len(points))
    labels = renumbered(moved(labels, pairs, few))
    thickness = noise / float(np.median(near.radius))
    if count is not None:
        return Segments(_of_count(labels, pairs, count, few), noise, (), thickness)
    rivals = _rivals(labels, pairs, _PART * len(points))
    return Segments(labels, noise, rivals, thickness)


def _of_count(
    labels: Int[np.ndarray, " n"], pairs: Pairs, count: int, least: float
) -> Int[np.ndarray, " n"]:
    """The labels with a given number of segments: the widest contacts joined, or waists cut."""
    while (found := int(labels.max(initial=-1)) + 1) > count:
        widths = contact_widths(labels, pairs)
        widest = max(widths, key=lambda pair: widths[pair], default=None)
        if widest is None or widths[widest] == 0.0:
            labels = np.where(labels == np.argmin(np.bincount(labels[labels >= 0])), -1, labels)
        else:
            labels = np.where(labels == widest[1], widest[0], labels)
        labels = renumbered(labels)
    while 0 < found < count:
        inside = [np.flatnonzero(labels == label) for label in range(found)]
        waists = [narrowest_waist(part, pairs, least) for part in inside]
        narrowest = int(np.argmin([waist.width for waist in waists]))
        if not np.isfinite(waists[narrowest].width):
            break
        labels = labels.copy()
        labels[inside[narrowest][waists[narrowest].part]] = found
        found += 1
    return labels


def _rivals(labels: Int[np.ndarray, " n"], pairs: Pairs, least: float) -> tuple[int, ...]:
    """Other numbers of segments, if a contact or a waist nearly has the width to count."""
    count = int(labels.max(initial=-1)) + 1
    widest = max(contact_widths(labels, pairs).values(), default=0.0)
    waists = [
        narrowest_waist(np.flatnonzero(labels == label), pairs, least).width
        for label in range(count)
    ]
    fewer = widest > (1 - _NEARLY) * _CONTACT
    more = min(waists, default=np.inf) < (1 + _NEARLY) * _WAIST
    return (count - 1,) * fewer + (count + 1,) * more
