"""The family of peony petals, Eqs. 7 and 8, in any pose and with every loss."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, cast

import numpy as np

from petalfit.components import PeonyPetal, Posed
from petalfit.fitting.coordinates import Coordinates, Prior, with_values
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.peony.known import known_starts
from petalfit.fitting.families.peony.outline import HEIGHTS
from petalfit.fitting.families.peony.outlines import ribbed_starts
from petalfit.fitting.families.peony.pose import Placed, placed_petals
from petalfit.fitting.families.peony.ribs import (
    RIBS,
    RibBasin,
    close,
    explaining,
    ribs_beside,
    with_ribs,
)
from petalfit.fitting.families.polish import START_POINTS, Polishing, follow
from petalfit.fitting.likelihood.cloud import BIAS_POINTS, ObservedCloud
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.outliers.annealing import approach, term_of
from petalfit.fitting.outliers.robust import Clutter
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.request.checks import POSES
from petalfit.fitting.request.request import Request, scan_of
from petalfit.fitting.solver.all_points import with_all_points
from petalfit.fitting.solver.iterate import Iterate, best_first
from petalfit.fitting.solver.observer import report
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.residuals import Data
from petalfit.surfaces import AbstractSurface, Pose, in_doubles, turn_between

# Further ribs that gain more than this in χ² on the residuals of an end show that it is wrong. By chance
# alone, the best of 200 frequencies gains 10.
_RIBS_LEFT = 20.0
# Number of poses that are tried first, and number along the normal of the best of these; more in an
# unknown unit or among outliers.
_TRIED, _TRIED_IN_DOUBT = (3, 0), (6, 4)
_TURNED_OVER = 3  # number of poses, the likeliest, that are tried the other way up among outliers
# A pose is not followed if its log likelihood is worse than the best by more than this per point.
_HOPELESS = 0.05
_RIVALS = 2  # number of poses, beside the likeliest, that are followed at most
_SAME_TURN = 0.1  # rad
_FEWEST = 64  # fewest points that determine a plane and an outline
_TYPICAL_EXTENT = 10.0  # root mean square distance of a petal's points from their middle


class PeonyFamily(AbstractFamily):
    """The family of peony petals, whose outline, heights and ribs are found one after the other."""

    kind: ClassVar[type[AbstractSurface]] = PeonyPetal
    poses: ClassVar[tuple[str, ...]] = POSES
    # A fitted pose makes the petal's place along its normal redundant.
    gauges: ClassVar[Mapping[str, tuple[str, ...]]] = {"rigid": ("c_z",), "similarity": ("c_z",)}
    is_petal: ClassVar[bool] = True
    takes: ClassVar[frozenset[str]] = AbstractFamily.takes | {"every_point"}

    def fit_cloud(self, request: Request) -> list[Iterate]:
        used = request.cloud.mass > 0
        frame = NormalisedFrame.of(request.cloud.points[used], request.pose)
        if request.pose == "similarity":
            # In this unit the cloud is as large as petals usually are in the model's unit.
            frame = dataclasses.replace(frame, unit=frame.unit / _TYPICAL_EXTENT)
        scan, _ = scan_of(request, frame, False)
        names = self.free_in(request.pose, request.free)
        if request.pose == "known":
            coordinates = Coordinates.of(request.template, names)
            ends = _from_known(coordinates, scan, request.from_template)
        else:
            free = self.not_redundant(request.pose, request.free)
            template = cast(PeonyPetal, request.template)
            begun = None
            if request.begun is not None:
                begun = frame.placed(template, request.begun)
            found = _from_anywhere(template, free, request.pose, scan, begun)
            ends = [_in_target(end, frame) for end in found]
        best, *others = ends
        return [with_all_points(best, 0, request.cloud), *others]

    def rough(self, coordinates: Coordinates) -> Coordinates:
        """Coordinates of a petal without ribs, if they are free."""
        if "rib_amplitude" not in coordinates.free:
            return coordinates
        smooth = with_values(coordinates.template, {"rib_amplitude": 0.0})
        return coordinates.around(smooth).holding(RIBS)

    def refined(
        self,
        coordinates: Coordinates,
        rough: AbstractSurface,
        clouds: Sequence[ObservedCloud],
        views: ObservedViews,
    ) -> Iterator[tuple[str, AbstractSurface]]:
        held = self.rough(coordinates)
        if held is not coordinates:
            yield from ribbed_starts(coordinates, held, rough, clouds, views)


def _in_target(end: Iterate, frame: NormalisedFrame) -> Iterate:
    """An end in the target's frame and unit."""
    (seen,) = end.residuals
    model = frame.back(cast(Posed, end.model))
    return dataclasses.replace(end, model=model, residuals=(frame.measured(seen),))


def _from_known(coordinates: Coordinates, scan: Scan, from_template: bool) -> list[Iterate]:
    """Ends of a fit in a known pose."""
    starts: Iterator[tuple[str, AbstractSurface]] | list[tuple[str, AbstractSurface]]
    starts = known_starts(coordinates, scan)
    if from_template:
        starts = [("given", coordinates.template)]
    return follow(coordinates, starts, Polishing(scan, coordinates))


def _from_anywhere(
    template: PeonyPetal, free: tuple[str, ...], pose: str, scan: Scan, begun: Posed | None
) -> list[Iterate]:
    """Ends of a fit in an unknown pose, for all poses that the cloud allows, or near a given one."""
    names = (*free, *Posed.free_in(pose))
    some = scan.some(START_POINTS)
    points, weights = scan.points[some], scan.weights[some]
    smooth = template
    if "rib_amplitude" in free:
        smooth = with_values(template, {"rib_amplitude": 0.0})
    background = scan.background or Clutter.around(scan.points)

    def approached(start: Placed) -> Iterate:
        posed = Posed(
            in_doubles(start.petal), start.rotation, start.translation, np.float64(start.unit)
        )
        held = Coordinates.of(posed, names).holding(RIBS)
        return approach(held, background, posed, points, weights)

    if begun is not None:
        place = begun.placement
        turn, shift = np.asarray(place.rotation), np.asarray(place.translation)
        start = Placed(smooth, turn, shift, float(place.scale), np.nan)
        return _polished_poses(template, names, scan, approached(start), "given")
    report("searching the pose")
    placed = placed_petals(smooth, free, points, pose)
    found: list[Iterate] = []
    easy = pose == "rigid" and scan.background is None
    at_first, again = _TRIED if easy else _TRIED_IN_DOUBT
    for k, start in enumerate(placed[:at_first]):
        report(f"approaching from pose {k + 1}")
        found.append(approached(start))
    best = max(found, key=_likelihood)
    members = _members(best)
    if again and np.count_nonzero(members > 0.5) > _FEWEST:
        report("searching again along its normal")
        inside = points[members > 0.5]
        placed = placed_petals(smooth, free, inside, pose, np.asarray(_placement(best).rotation))
        found += map(approached, placed[:again])
    if scan.background is not None:
        report("turning the likeliest over")
        found += [approached(_turned_over(near)) for near in _distinct(found)[:_TURNED_OVER]]
    best, *others = _distinct(found)
    bound = _HOPELESS * len(points)
    rivals = [near for near in others if _likelihood(best) - _likelihood(near) <= bound]
    if _likelihood(best) <= bound:
        rivals = []  # No pose is much likelier than clutter alone.
    ends: list[Iterate] = []
    for k, near in enumerate([best, *rivals[:_RIVALS]]):
        ends += _polished_poses(template, names, scan, near, f"pose {k + 1}")
    return best_first(ends)


def _distinct(found: list[Iterate]) -> list[Iterate]:
    """The likeliest of each pose, the likeliest pose first."""
    chosen: list[Iterate] = []
    for near in sorted(found, key=_likelihood, reverse=True):
        rotation = _placement(near).rotation
        if all(turn_between(rotation, _placement(x).rotation) >= _SAME_TURN for x in chosen):
            chosen.append(near)
    return chosen


def _turned_over(near: Iterate) -> Placed:
    """The petal that lies in nearly the same place the other way up; its waves tell which is right."""
    posed = cast(Posed, near.model)
    petal, place = cast(PeonyPetal, posed.surface), _placement(near)
    over = with_values(petal, {name: -float(getattr(petal, name)) for name in HEIGHTS})
    rotation = np.asarray(place.rotation) @ np.diag([-1.0, 1.0, -1.0])
    return Placed(over, rotation, np.asarray(place.translation), float(place.scale), np.nan)


def _polished_poses(
    template: PeonyPetal, names: tuple[str, ...], scan: Scan, near: Iterate, label: str
) -> list[Iterate]:
    """Ends near one pose, one for each rib frequency that the cloud allows."""
    smooth = cast(Posed, near.model)
    coordinates = Coordinates.of(smooth.at_rest(in_doubles(template)), names)
    smooth = smooth.at_rest(in_doubles(smooth.surface))
    term = term_of(near)
    ends: list[Iterate] = []

    def labelled(basin: RibBasin) -> tuple[str, AbstractSurface]:
        name, model = with_ribs(smooth, basin)
        return f"{label}, {name}", model

    def starts() -> Iterator[tuple[str, AbstractSurface]]:
        if not set(RIBS) & set(names):
            yield f"{label}, smooth", smooth
            return
        basins = ribs_beside(coordinates, smooth, ObservedCloud(term.data), term)
        # Among outliers a periodogram is less reliable: there all its peaks are followed.
        first = close(basins) if scan.background is None else basins
        yield from map(labelled, first)
        rest = basins[len(first) :]
        # If the smooth petal is not quite the right one, ribs may seem to have another frequency.
        best = min(ends, key=lambda end: end.chi2, default=None)
        if rest and (best is None or _ribs_left(coordinates, scan, best)):
            yield from map(labelled, rest)

    polish = Polishing(scan, coordinates)

    def end_of(name: str, model: AbstractSurface, prior: Prior | None) -> Iterate | None:
        end = polish(name, model, prior)
        ends.extend([] if end is None else [end])
        return end

    return follow(coordinates, starts(), end_of)


def _ribs_left(coordinates: Coordinates, scan: Scan, end: Iterate) -> bool:
    """Whether other ribs would explain the residuals of an end, so that its own are the wrong ones."""
    (seen,) = end.residuals
    assert seen.uv is not None
    some = scan.order[:BIAS_POINTS]
    data = Data.of(scan.points[some], seen.weights[some], seen.noise)
    return explaining(coordinates.around(end.model), data, seen.uv[some])[0].gain > _RIBS_LEFT


def _likelihood(near: Iterate) -> float:
    """Its log likelihood; −∞ if it has broken."""
    assert near.mixture is not None
    return float(np.nan_to_num(near.mixture.log_likelihood, nan=-np.inf))


def _members(near: Iterate) -> np.ndarray:
    assert near.mixture is not None
    return near.mixture.members


def _placement(near: Iterate) -> Pose:
    return cast(Posed, near.model).placement
