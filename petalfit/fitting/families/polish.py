"""Polishing: every start is fitted to all points, and the ends are compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable

import numpy as np

from petalfit.compilation import stage
from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.inference.pinning import pinned
from petalfit.fitting.likelihood.cloud import BIAS_POINTS, ObservedCloud
from petalfit.fitting.likelihood.condensed_cloud import ENOUGH, CondensedCloud
from petalfit.fitting.likelihood.foot_points import guess_foot_points
from petalfit.fitting.likelihood.relief import beside_many
from petalfit.fitting.outliers.annealing import clear, term_of
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.solver.alternate import minimise, whiten
from petalfit.fitting.solver.debias import without_bias
from petalfit.fitting.solver.iterate import Iterate, best_first
from petalfit.fitting.solver.observer import report
from petalfit.residuals import Data
from petalfit.surfaces import AbstractSurface

# Number of points that starts are found with. It is enough for the ribs, which are fine, and small clouds
# are fitted with programs of a single size.
START_POINTS = 1536
_ROUNDS = 30
_TOLERANCE = 1e-2  # standard errors
# Among outliers a start is given up if its χ² with some of the points is worse than that of another one
# by more than this.
_HOPELESS = 60.0
_PART = 1 << 16  # points of a large cloud that are condensed first
# Standard errors by which a large cloud that is condensed anew may move the end; the next time it would
# move by less than half of that, unless a few points go to and fro between two layers of a fold.
_SAME = 0.5


def follow(
    coordinates: Coordinates,
    starts: Iterable[tuple[str, AbstractSurface]],
    end_of: Callable[[str, AbstractSurface, Prior | None], Iterate | None],
) -> list[Iterate]:
    """The ends of starts, the best first; its undetermined parameters keep the template's values.

    Args:
        coordinates: The free parameters.
        starts: The starts, with their labels.
        end_of: A function that finds the end of a start, given its label, its model and a prior; it may
            return None for a start without hope, but not for the first one.
    """
    ends = []
    for label, model in starts:
        report(f"polishing from {label}")
        with stage("polishing"):
            end = end_of(label, model, None)
            ends += [] if end is None else [end]
    best, *others = best_first(ends)

    def again(model: AbstractSurface, prior: Prior) -> Iterate:
        end = end_of(best.label, model, prior)
        assert end is not None
        return end

    with stage("polishing"):
        return [pinned(coordinates, best, again), *others]


class Polishing:
    """Finds the ends of starts in one scan, with some of its points first, then with all.

    The second stage thus begins within a few standard errors of its end. A start that is clearly worse
    than an earlier one after the first stage is given up. A large cloud is condensed for the second stage
    beside a surface with edges, unless every point is to take part in every step.
    """

    def __init__(self, scan: Scan, coordinates: Coordinates) -> None:
        self._scan = scan
        self._coordinates = coordinates
        self._least = np.inf  # χ² after the first stage, the least so far
        sheet = all(coordinates.template.edges)
        self._condenses = len(scan.points) > ENOUGH and sheet and not scan.every_point

    def __call__(self, label: str, model: AbstractSurface, prior: Prior | None) -> Iterate | None:
        """The end of a start; None if it has no hope. With a prior, every start has an end."""
        scan, coordinates, near = self._scan, self._coordinates, None
        if len(scan.order) > 2 * START_POINTS:
            some = scan.some(START_POINTS)
            near = _polished_on(scan, coordinates, model, some, 10, 0.1, prior)[0]
            if near.mixture is not None and prior is None:
                chi2 = -2 * near.mixture.log_likelihood
                self._least = min(self._least, chi2)
                if chi2 > self._least + _HOPELESS:
                    return None
            model = near.model
        if near is not None and self._condenses:
            end, cloud = _by_passes(scan, coordinates, near, prior)
        else:
            every = np.arange(len(scan.points))
            end, weights = _polished_on(scan, coordinates, model, every, _ROUNDS, _TOLERANCE, prior)
            cloud = ObservedCloud.of(scan.points, weights, scan.noise, scan.order)
        end = without_bias(coordinates, label, [cloud], end, prior)
        return end if end.mixture is None else likelier(end, scan)


def _by_passes(
    scan: Scan, coordinates: Coordinates, near: Iterate, prior: Prior | None
) -> tuple[Iterate, CondensedCloud]:
    """The end in a large cloud, which is condensed again where the last steps ended."""
    points, weights, mixture = scan.points, scan.weights, near.mixture
    first = scan.order[:BIAS_POINTS]
    if scan.background is not None:
        # Outliers are searched for among so many points; then all are judged by what was learned.
        some = points[first], weights[first], scan.noise
        near = clear(coordinates, scan.background, near.model, *some, prior)
        beside = beside_many(near.model, points)[:2]
        mixture = scan.background.mixture(near.model, *beside, weights, scan.noise)
        weights = weights * mixture.members
    sample = Data.of(points[first], weights[first], scan.noise)
    blur, rounds, moved = float(term_of(near).sigma), near.rounds, np.inf
    # A part of the points brings the end within a few standard errors of that of all points.
    some = scan.order[:_PART] if len(points) > 2 * _PART else slice(None)
    while True:
        cloud = CondensedCloud.near(
            near.model, points[some], weights[some], scan.noise, blur, len(coordinates.free), sample
        )
        end = minimise(coordinates, [cloud], near.model, [cloud.start], _ROUNDS, _TOLERANCE, prior)
        rounds += end.rounds
        before, moved = moved, _away(coordinates, cloud, near, end)
        near, whole = end, len(cloud.points) == len(points)
        if whole and (moved < _SAME or moved > before / 2):
            break
        if not whole:
            some, moved = slice(None), np.inf
    used = {"first steps": START_POINTS, "last steps": cloud.count, "residuals": len(points)}
    end = dataclasses.replace(
        end, rounds=rounds, moved=max(moved, end.moved), mixture=mixture, points_used=used
    )
    return end, cloud


def _away(coordinates: Coordinates, cloud: CondensedCloud, near: Iterate, end: Iterate) -> float:
    """How far two iterates are apart, in standard errors, the largest over all directions."""
    t = coordinates.inverse(end.model)
    information, _ = cloud.information(coordinates, t, term_of(end))
    step = np.linalg.solve(
        whiten(information + np.eye(len(t))), t - coordinates.inverse(near.model)
    )
    return float(np.max(np.abs(step)))


def likelier(end: Iterate, scan: Scan) -> Iterate:
    """An end with the χ² of its mixture, by which ends are compared if there may be outliers.

    The information is that of points of which it is not certain whether they belong to the surface.
    """
    assert end.mixture is not None
    weights, certainty = scan.weights[scan.likely], end.mixture.certainty
    kept = float(np.sum(weights * (end.mixture.members[scan.likely] > 0.5)))
    return dataclasses.replace(
        end.informed(certainty),
        chi2=-2 * end.mixture.log_likelihood,
        left_out=1 - kept / max(float(np.sum(weights)), 1e-300),
    )


def _polished_on(
    scan: Scan,
    coordinates: Coordinates,
    model: AbstractSurface,
    some: np.ndarray,
    rounds: int,
    tolerance: float,
    prior: Prior | None,
) -> tuple[Iterate, np.ndarray]:
    """The end of a start on some of the points, and the weights of these points in it."""
    points, weights, mixture = scan.points[some], scan.weights[some], None
    if scan.background is not None:
        near = clear(coordinates, scan.background, model, points, weights, scan.noise, prior)
        mixture = near.mixture
        assert mixture is not None
        members = weights * mixture.members
        if np.sum(members) >= len(coordinates.free):
            return near, members
        # Too few points are left that belong to the surface: the result then is its distance from all.
        model, rounds = near.model, 1
    cloud = ObservedCloud(Data.of(points, weights, scan.noise))
    start = cloud.at(guess_foot_points(model, cloud.data.points))
    end = minimise(coordinates, [cloud], model, [start], rounds, tolerance, prior)
    again = cloud.rematched(end.model, term_of(end))
    if again is not None:
        more = minimise(coordinates, [cloud], end.model, [again], rounds, tolerance, prior)
        end = dataclasses.replace(more, rounds=end.rounds + more.rounds)
    return dataclasses.replace(end, mixture=mixture), weights
