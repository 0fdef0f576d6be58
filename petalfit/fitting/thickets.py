"""Segments in a thicket, such as that of the stamens of a peony: sheets that are no petals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.segmentation.neighbours import Neighbours
from petalfit.fitting.siblings import Petal
from petalfit.results import Status

# Part of the neighbours that lie in no segment, from which a segment is one of a thicket.
_FRAYED = 0.1


def without_thickets(
    fitted: Sequence[Petal], seen: Float[np.ndarray, "n 3"], labels: Int[np.ndarray, " n"]
) -> list[Petal]:
    """The petals without those that have no petal's shape, in a place where points lie on no sheet.

    Both are needed: a petal may have a shape that the model cannot follow, and the innermost petals of a
    rose lie among points of no sheet.

    Args:
        fitted: The petals.
        seen: The points among which the segments were found.
        labels: The segment of each of these points, −1 for none.
    """
    misfits = [petal for petal in fitted if petal.result.status is Status.MISFIT]
    if not misfits:
        return list(fitted)
    theirs = labels[Neighbours.of(seen).others]
    frayed = {
        petal.segment for petal in misfits if np.mean(theirs[labels == petal.segment] < 0) > _FRAYED
    }
    kept = [petal for petal in fitted if petal.segment not in frayed]
    return kept or list(fitted)
