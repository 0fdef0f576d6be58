"""The sheets of a cloud: smooth pieces of surfaces, whatever they belong to."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.segmentation.linkage import count_of, facets, joined, moved, renumbered
from petalfit.fitting.segmentation.neighbours import COUNT, Neighbours
from petalfit.fitting.segmentation.pairs import Pairs
from petalfit.fitting.segmentation.planes import tangent_planes
from petalfit.fitting.segmentation.quadrics import Quadrics
from petalfit.fitting.segmentation.waists import cut_at_waists

FEWEST = 20 * COUNT
CONTACT = 0.38  # a contact of this relative width is one within a sheet
WAIST = 0.33  # a waist below this relative width is one between two sheets
PART = 0.03  # smallest share of all points that a part has which is cut off at a waist
_GUESS = 0.3  # noise to begin with, in median distances to the nearest neighbour
_EXACT = 0.1  # least noise, in the same; sheets without any are not followed more closely
_FIRST = 20  # points of the smallest facets that are joined
_LEAST = 0.008  # smallest share of all points that a sheet has
_ROUNDS = 3


@dataclasses.dataclass(frozen=True)
class Sheets:
    """The sheets of a cloud.

    Attributes:
        labels: The sheet of every point, −1 for none, shape (n,).
        pairs: The pairs of near points, with the evidence that both lie on one sheet.
        noise: Standard deviation of the points' distances from their sheets.
        thickness: The noise in median radii of neighbourhoods: 0.3 where points fill space.
        least: The least number of points of a sheet.
    """

    labels: Int[np.ndarray, " n"]
    pairs: Pairs
    noise: float
    thickness: float
    least: float

    @property
    def count(self) -> int:
        """The number of sheets."""
        return count_of(self.labels)


def sheets_of(points: Float[np.ndarray, "n 3"], seed: int = 0) -> Sheets:
    """Finds the sheets of a cloud.

    Near points are compared by their tangent planes and by quadrics through their neighbours. Facets grow
    from the pairs that agree; they end at creases, at edges and where sheets touch. Facets with a wide
    smooth contact are then joined to sheets, and sheets are cut where they have a narrow waist.

    Args:
        points: Shape (n, 3), at least `FEWEST`.
        seed: The seed of random choices; the result hardly depends on it.
    """
    near = Neighbours.of(points)
    apart = float(np.median(near.distance[:, 0]))
    planes = tangent_planes(near, noise := _GUESS * apart, seed)
    for _ in range(2):
        noise = max(Quadrics.of(near, planes, noise).noise(), _EXACT * apart)
    pairs = Pairs.of(near, Quadrics.of(near, planes, noise), noise)
    labels, few, least = facets(pairs, len(points)), float(_FIRST), _LEAST * len(points)
    for _ in range(_ROUNDS):
        labels = joined(moved(labels, pairs, few), pairs, CONTACT)
        few = max(least, float(_FIRST))
        labels = cut_at_waists(labels, pairs, WAIST, PART * len(points))
    labels = renumbered(moved(labels, pairs, few))
    return Sheets(labels, pairs, noise, noise / float(np.median(near.radius)), few)
