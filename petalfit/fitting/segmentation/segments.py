"""The segments of a cloud: the sheets that may be petals, found without a model of a petal."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from petalfit.fitting.segmentation.linkage import (
    contact_widths,
    count_of,
    members_of,
    moved,
    renumbered,
)
from petalfit.fitting.segmentation.lobes import lobes_of
from petalfit.fitting.segmentation.meeting import meeting_point
from petalfit.fitting.segmentation.pairs import Pairs
from petalfit.fitting.segmentation.sheets import CONTACT, PART, WAIST, sheets_of
from petalfit.fitting.segmentation.table import table_among
from petalfit.fitting.segmentation.tubes import on_tubes
from petalfit.fitting.segmentation.waists import narrowest_waist

_NEARLY = 0.25  # relative difference from these widths at which another number of sheets is a rival
# Size of a segment, by that of the median one and by the middle size, below which it is no petal.
_SCRAP, _CRUMB = 0.15, 0.1
# Size and reach from where the petals meet, by those of the median segment, below which a segment is a
# piece of fused bases. The innermost petals of a rose reach 0.7.
_PIECE, _SHORT = 0.35, 0.62
_THIN = 0.5  # size of a piece of a tube, by the middle size, at the most
_ROUNDS = 3


@dataclasses.dataclass(frozen=True)
class Segments:
    """The segments of a cloud.

    Attributes:
        labels: The segment of every point, −1 for none, shape (n,).
        noise: Standard deviation of the points' distances from their sheets.
        rivals: Other numbers of segments that the evidence hardly excludes.
        thickness: The noise in median radii of neighbourhoods: 0.3 where points fill space.
        contacts: The widths of the smooth contacts of two segments, by the root of the smaller one's
            number of points; the smaller label comes first. Lobes of one sheet have none.
        table: Whether each point lies on a table, which is no segment, shape (n,).
        tubes: Whether each point lies on a tube, such as a stalk, which is no segment, shape (n,).
    """

    labels: Int[np.ndarray, " n"]
    noise: float
    rivals: tuple[int, ...]
    thickness: float
    contacts: Mapping[tuple[int, int], float]
    table: Bool[np.ndarray, " n"]
    tubes: Bool[np.ndarray, " n"]

    @property
    def count(self) -> int:
        """The number of segments."""
        return count_of(self.labels)


def segments_of(
    points: Float[np.ndarray, "n 3"], count: int | None = None, seed: int = 0
) -> Segments:
    """Finds the segments of a cloud of several sheets, which may wrap and touch each other.

    Sheets are the first guess; see `sheets_of`. A table and tubes are no segments, petals that are fused
    at their bases are cut from each other, and scraps are left out.

    Args:
        points: Shape (n, 3), at least `FEWEST`.
        count: The number of segments, if it is known.
        seed: The seed of random choices; the result hardly depends on it.
    """
    sheets = sheets_of(points, seed)
    pairs, noise, least = sheets.pairs, sheets.noise, sheets.least
    table, tubes = _no_petals(sheets.labels, points, noise)
    labels = whole = renumbered(np.where(table | tubes, -1, sheets.labels))
    labels, more_or_fewer = _cut_at_lobes(labels, points, pairs, least)
    trimmed = _with_bases_shared_out(_without_scraps(labels), points, pairs, least)
    if count is not None:
        if count_of(trimmed) >= count:
            labels = trimmed
        labels = _of_count(labels, pairs, count, least)
        return Segments(labels, noise, (), sheets.thickness, {}, table, tubes)
    more_or_fewer |= _in_doubt(whole, trimmed, pairs, PART * len(points))
    rivals = tuple(sorted(count_of(trimmed) + k for k in more_or_fewer))
    contacts = _contacts(trimmed, whole, pairs)
    return Segments(trimmed, noise, rivals, sheets.thickness, contacts, table, tubes)


def _no_petals(
    labels: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"], noise: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which points lie on a table, and which on tubes."""
    inside, on_table = members_of(labels), np.zeros(len(labels), bool)
    table = table_among(points, inside, noise)
    if table is not None:
        on_table[inside.pop(table)] = True
    middle = middle_size(np.array([len(segment) for segment in inside]))
    thin = [segment for segment in inside if len(segment) < _THIN * middle]
    return on_table, on_tubes(points, thin, noise) & ~on_table


def _cut_at_lobes(
    labels: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"], pairs: Pairs, least: float
) -> tuple[Int[np.ndarray, " n"], frozenset[int]]:
    """The labels after segments of petals that are fused at their bases have been cut, and its rivals.

    With more segments the place of the bases is better known, so that others can then be cut.
    """
    rivals: frozenset[int] = frozenset()
    for _ in range(_ROUNDS):
        inside = members_of(labels)
        base = meeting_point([points[part] for part in inside]) if len(inside) > 1 else None
        found = [lobes_of(points, part, pairs, base, least) for part in inside]
        rivals = frozenset().union(*(lobes.rivals for lobes in found))
        if all(lobes.count == 1 for lobes in found):
            break
        labels, number = labels.copy(), len(inside)
        for part, lobes in zip(inside, found, strict=True):
            for lobe in range(1, lobes.count):
                labels[part[lobes.labels == lobe]] = number
                number += 1
    return labels, rivals


def _contacts(
    labels: Int[np.ndarray, " n"], whole: Int[np.ndarray, " n"], pairs: Pairs
) -> dict[tuple[int, int], float]:
    """The contacts of segments that were never one."""
    sheet = [int(np.bincount(whole[part] + 1).argmax()) for part in members_of(labels)]
    widths = contact_widths(labels, pairs)
    return {(a, b): width for (a, b), width in widths.items() if sheet[a] != sheet[b]}


def middle_size(sizes: Int[np.ndarray, " k"]) -> int:
    """The size of which half of all points lie in larger segments, however many small ones there are."""
    if not len(sizes):
        return 0
    sizes = np.sort(sizes)
    return int(sizes[np.searchsorted(np.cumsum(sizes), 0.5 * sizes.sum())])


def _without_scraps(labels: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The labels without segments that are far smaller than the others, which are no petals."""
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    least = max(_SCRAP * np.median(sizes), _CRUMB * middle_size(sizes))
    scraps = np.flatnonzero(sizes < least)
    return renumbered(np.where(np.isin(labels, scraps), -1, labels))


def _with_bases_shared_out(
    labels: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"], pairs: Pairs, least: float
) -> Int[np.ndarray, " n"]:
    """The labels after pieces of fused bases have been shared out among the petals around them."""
    parts = [points[part] for part in members_of(labels)]
    if len(parts) < 2:
        return labels
    sizes = np.array([len(part) for part in parts])
    small = sizes < _PIECE * np.median(sizes)
    if not small.any():
        return labels
    base = meeting_point(parts)
    reach = np.array([np.linalg.norm(part - base, axis=1).max() for part in parts])
    pieces = np.isin(labels, np.flatnonzero(small & (reach < _SHORT * np.median(reach))))
    rest = np.where(pieces, -1, labels)
    return renumbered(np.where(pieces, moved(rest, pairs, least), labels))


def _of_count(
    labels: Int[np.ndarray, " n"], pairs: Pairs, count: int, least: float
) -> Int[np.ndarray, " n"]:
    """The labels with a given number of segments: the widest contacts joined, or waists cut."""
    while (found := count_of(labels)) > count:
        widths = contact_widths(labels, pairs)
        widest = max(widths, key=lambda pair: widths[pair], default=None)
        if widest is None or widths[widest] == 0.0:
            labels = np.where(labels == np.argmin(np.bincount(labels[labels >= 0])), -1, labels)
        else:
            labels = np.where(labels == widest[1], widest[0], labels)
        labels = renumbered(labels)
    while 0 < found < count:
        inside = members_of(labels)
        waists = [narrowest_waist(part, pairs, least) for part in inside]
        narrowest = int(np.argmin([waist.width for waist in waists]))
        if not np.isfinite(waists[narrowest].width):
            break
        labels = labels.copy()
        labels[inside[narrowest][waists[narrowest].part]] = found
        found += 1
    return labels


def _in_doubt(
    whole: Int[np.ndarray, " n"], labels: Int[np.ndarray, " n"], pairs: Pairs, least: float
) -> frozenset[int]:
    """−1 if a contact nearly has the width to count, 1 if a waist nearly is narrow enough.

    Lobes of one segment have wide contacts, so that contacts are those of the whole segments.
    """
    widest = max(contact_widths(whole, pairs).values(), default=0.0)
    waists = [narrowest_waist(part, pairs, least).width for part in members_of(labels)]
    fewer = widest > (1 - _NEARLY) * CONTACT
    more = min(waists, default=np.inf) < (1 + _NEARLY) * WAIST
    return frozenset([-1] * fewer + [1] * more)
