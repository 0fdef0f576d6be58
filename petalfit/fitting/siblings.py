"""Petals of one flower help one another: one that was fitted wrongly is fitted as its siblings are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.arrangement import Axis, Placed, regular_axis
from petalfit.fitting.fit import fit
from petalfit.fitting.flower_result import base_of
from petalfit.fitting.result import FitResult
from petalfit.fitting.segmentation.members import Sheet
from petalfit.surfaces import AbstractSurface

_ALIKE = 1.5  # factor in area or squared scale from the median petal, up to which a petal is alike
_MOST_ALIKE = 0.6  # the share of petals that are alike, below which petals of the flower are not
_SIBLINGS = 3  # siblings that are tried as starts, and the fewest that there are
_AS_GOOD = 0.01  # share of the points that a fit like that of a sibling may explain less


class Petal(NamedTuple):
    """A petal that was fitted.

    Attributes:
        segment: The number of its segment.
        points: The points that it was fitted to.
        result: Its fit.
        sheet: Its surface.
    """

    segment: int
    points: Float[np.ndarray, "n 3"]
    result: FitResult
    sheet: Sheet

    @classmethod
    def of(cls, segment: int, points: Float[np.ndarray, "n 3"], result: FitResult) -> Petal:
        return cls(segment, points, result, Sheet.of(result.mesh()))

    def with_result(self, result: FitResult) -> Petal:
        """The same petal with another fit."""
        return Petal.of(self.segment, self.points, result)

    def explained(self, noise: float) -> float:
        """The share of the points that lie on the surface."""
        return self.sheet.explained(self.points, noise)


def like_siblings(
    fitted: Sequence[Petal],
    noise: float,
    model: type[AbstractSurface] | AbstractSurface,
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> Iterator[Petal]:
    """The petals; one that is unlike the others is fitted again from where its siblings would be.

    A sibling is turned about the flower's axis until it stands where the petal does. If its fit explains
    the points as well, it is the likelier one, because petals of a flower are alike.

    Args:
        fitted: The petals.
        noise: Standard deviation of the points' distances from their sheets.
        model: The class of the petals, or a petal whose fixed parameters are kept.
        options: The options of all fits.
        say: A function that is called with a line of text at each new fit.
    """
    sizes = np.array([[p.sheet.area, float(p.result.pose.scale) ** 2] for p in fitted])
    alike = np.all(np.abs(np.log(sizes / np.median(sizes, axis=0))) < np.log(_ALIKE), axis=1)
    alike &= np.array([petal.result.converged for petal in fitted])
    siblings = [petal.result for petal, usual in zip(fitted, alike, strict=True) if usual]
    if alike.all() or alike.mean() < _MOST_ALIKE or len(siblings) < _SIBLINGS:
        yield from fitted
        return
    placed = placed_of(siblings)
    axis, _ = regular_axis(placed)
    for number, (petal, usual) in enumerate(zip(fitted, alike, strict=True)):
        if usual:
            yield petal
            continue
        say(f"petal {number + 1} of {len(fitted)} from its siblings")
        others = (
            petal.with_result(fit(model, petal.points, init=start, **options))
            for start in _turned(siblings, placed, axis, petal.points.mean(axis=0))
        )
        enough = petal.explained(noise) - _AS_GOOD
        good = (x for x in others if x.result.converged and x.explained(noise) > enough)
        yield next(good, petal)


def _turned(
    siblings: Sequence[FitResult], placed: Placed, axis: Axis, place: Float[np.ndarray, "3"]
) -> Iterator[FitResult]:
    """The siblings that stand as high and as far out as a place, turned about the axis to it."""
    away = np.linalg.norm(axis.upright(placed.middle) - axis.upright(place[None]), axis=1)
    for k in np.argsort(away)[:_SIBLINGS].tolist():
        turn = axis.turning(placed.middle[k], place)
        yield dataclasses.replace(siblings[k], pose=turn @ siblings[k].pose)


def placed_of(petals: Sequence[FitResult]) -> Placed:
    """The places of fitted petals."""
    return Placed(
        np.stack([base_of(petal) for petal in petals]),
        np.stack([np.asarray(petal.mesh((17, 17)).vertices).mean(axis=0) for petal in petals]),
        np.stack([np.asarray(petal.pose.rotation)[:, 1] for petal in petals]),
    )
