"""Families of open surfaces in any pose: a few starts, and descents from them to a stationary point."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar, TypeVar

import numpy as np
from jaxtyping import Float

from petalfit.compilation import BLOCK, prepared, stage
from petalfit.components import Posed
from petalfit.fitting.coordinates import with_values
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.polish import likelier
from petalfit.fitting.inference.discrepancy import INDEPENDENT, discrepancy_of, temperature
from petalfit.fitting.inference.linear_rows import may_have_misfit, rows_of
from petalfit.fitting.likelihood.condensed_sheet import COARSE, ENOUGH, FINE, CondensedSheet
from petalfit.fitting.likelihood.observed import Residuals
from petalfit.fitting.likelihood.relief import beside_many
from petalfit.fitting.likelihood.sheet import Sheet
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.request.checks import POSES
from petalfit.fitting.request.request import Request, scan_of
from petalfit.fitting.solver.all_points import with_all_points
from petalfit.fitting.solver.descent import Descent, DescentEnd, begun, descend
from petalfit.fitting.solver.iterate import Iterate, best_first
from petalfit.fitting.solver.observer import report
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.observations import PointCloud
from petalfit.residuals import pulled
from petalfit.surfaces import AbstractSurface, in_doubles, value_at

# Numbers of points for the search for starts, and for rough steps.
_SOME = 1536
_ROUGHLY = BLOCK
_FOLLOWED = 2
_ROUGH, _NEAR = 40, 1.0  # rough steps at most, and standard errors to their end
_FIRST, _LIKELY = 12, 4  # rough steps of all starts, and the number of starts that take more
_ROUNDS = 100  # evaluations of the likelihood at most
# A start whose cost after rough steps is worse than the best by more than this, and by more than it may
# still gain, is not followed.
_HOPELESS = 8.0
_CLEARINGS, _AGAIN = 3, 6  # searches for outliers, and steps before each of them
_SIFTED = 8192  # points that outliers are searched for among
_UNCHANGED = 0.002  # a smaller mean change of the probabilities is none
# A large cloud is condensed at most so often, until the end moves by less than so many standard errors.
_PASSES, _SAME = 3, 2.0
_CLOSELY = 0.1  # standard errors to the end of a large cloud, whose steps cost little
_WORSE = 0.01  # χ² per point of a clearly worse end; by coarse cells it is wrong by less than 0.001


Start = TypeVar("Start", bound="CloudStart")


@dataclasses.dataclass(frozen=True)
class CloudStart:
    """A start: a model that roughly follows a cloud.

    Attributes:
        model: The model in its own frame. With pose="similarity" its gauge has the template's value.
        rotation: The rotation from the model's frame to the cloud's, shape (3, 3).
        translation: The model's origin in the cloud's frame, shape (3,).
        scale: The length of the model's unit in the cloud's frame.
        label: A name that distinguishes the start from the others.
    """

    model: AbstractSurface
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    scale: float
    label: str

    def scaled(self: Start, length: str, pose: str) -> Start:
        """The start with its scale moved into the model, unless the pose has a scale.

        Args:
            length: The parameter that all lengths of the model are proportional to.
            pose: "known", "rigid" or "similarity".
        """
        if pose == "similarity":
            return self
        longer = with_values(self.model, {length: value_at(self.model, length) * self.scale})
        return dataclasses.replace(self, model=longer, scale=1.0)

    def posed(self, pose: str) -> AbstractSurface:
        """The model, as a `Posed` one unless the pose is known."""
        if pose == "known":
            return self.model
        return Posed(self.model, self.rotation, self.translation, self.scale)


class OpenSurfaceFamily(AbstractFamily):
    """A family whose models are open surfaces, for which a subclass finds starts.

    A subclass defines its `kind` and `gauges`, and the method `starts`. Its models can then be fitted in
    every pose, with every loss.
    """

    poses: ClassVar[tuple[str, ...]] = POSES
    takes: ClassVar[frozenset[str]] = AbstractFamily.takes | {"base", "every_point"}

    @abc.abstractmethod
    def starts(
        self,
        template: AbstractSurface,
        free: tuple[str, ...],
        points: Float[np.ndarray, "n 3"],
        pose: str,
    ) -> Sequence[CloudStart]:
        """Starts for a cloud, the likeliest first. See `followed`.

        Args:
            template: A model with the values of the parameters that are not free.
            free: Names of the free parameters, without the gauge and those of the pose.
            points: Points in the cloud's normalised frame; most of them belong to the surface.
            pose: "known": rotation and translation of a start are not used. "rigid": the model has the
                unit of the cloud, and the start has scale 1. "similarity": all of them are used.
        """

    def followed(self, starts: Sequence[CloudStart]) -> Sequence[CloudStart]:
        """The starts of descents, of all starts that were found."""
        return starts[:_FOLLOWED]

    def labels(self, starts: Sequence[CloudStart]) -> list[str]:
        """The labels of the ends in a result, given their starts, with that of the best end first."""
        return [start.label for start in starts]

    def foresee(
        self, template: AbstractSurface, free: tuple[str, ...], pose: str
    ) -> tuple[Callable[[], None], ...]:
        names = self.free_in(pose, free)
        somewhere = template
        if pose != "known":
            somewhere = Posed(template, np.eye(3), np.zeros(3), 1.0)
        somewhere = in_doubles(somewhere)
        # Programs depend on the number of points, and not on where these are.
        points = np.random.default_rng(0).normal(size=(_ROUGHLY, 3))
        sheet = Sheet(points, np.ones(_ROUGHLY))

        def begin() -> None:
            begun(Descent.of(somewhere, names, sheet), somewhere)

        def end() -> None:
            uv = sheet.beside(somewhere, np.zeros((_ROUGHLY, 2)))[2]
            pulled(somewhere, uv, np.ones((_ROUGHLY, 3)), names, points)

        return prepared(begin), prepared(end)

    def fit_cloud(self, request: Request) -> list[Iterate]:
        used = request.cloud.mass > 0
        frame = NormalisedFrame.of(request.cloud.points[used], request.pose)
        scan, order = scan_of(request, frame, True)
        sheets, masses = scan.points[scan.likely], scan.weights[scan.likely]
        names = self.free_in(request.pose, request.free)
        few = Sheet(sheets[:_ROUGHLY], masses[:_ROUGHLY])
        heat = max(len(few.points) / INDEPENDENT, 1.0)

        def problem(model: AbstractSurface) -> Descent:
            return Descent.of(model, names, few, scan.noise, heat)

        descents_foreseen, end_foreseen, *_ = self.foresee(
            request.template, request.free, request.pose
        )
        given = request.template
        if request.begun is not None:
            given = frame.placed(given, request.begun)
        starts: list[tuple[str, AbstractSurface]] = [("given", given)]
        found: Sequence[CloudStart] = ()
        if not request.from_template:
            report("flattening the cloud")
            free = self.not_redundant(request.pose, request.free)
            every = self.starts(request.template, free, sheets[:_SOME], request.pose)
            if request.base is not None:
                every = [_with_base_near(every, frame.into(np.array([request.base]))[0])]
            found = self.followed(every)
            starts = [(start.label, start.posed(request.pose)) for start in found]
        descents_foreseen()
        used = {"starts": min(_SOME, len(sheets)), "rough steps": len(few.points)}
        with stage("polishing"):
            near = _roughly([begun(problem(model), model, label) for label, model in starts])
        end_foreseen()
        heat = _temperature(near[0], names)
        large = len(scan.points) > ENOUGH and not scan.every_point
        if len(scan.points) > 2 * _SOME:
            used["steps with some"] = min(_SOME, len(sheets))
            report("polishing with some of the points")
            with stage("polishing"):
                near = _promising([_with_some(end, scan, heat) for end in near])
        ends: list[Iterate] = []
        for end in near:
            report(f"polishing from {end.label}")
            least = min((other.chi2 for other in ends), default=np.inf)
            with stage("polishing"):
                ends.append(_descended(end, scan, heat, least, large))
        ends = best_first(ends)
        if found:
            by_label = {start.label: start for start in found}
            labels = self.labels([by_label[end.label] for end in ends])
            ends = [dataclasses.replace(e, label=x) for e, x in zip(ends, labels, strict=True)]
        ends = [self._in_target(end, names, frame, order) for end in ends]
        if large:
            used = used | ends[0].points_used | {"residuals": len(scan.points)}
            ends[0] = dataclasses.replace(ends[0], points_used=used)
        return [with_all_points(ends[0], 0, request.cloud), *ends[1:]]

    def _in_target(
        self, end: Iterate, names: tuple[str, ...], frame: NormalisedFrame, order: np.ndarray
    ) -> Iterate:
        """An end in the target's frame and unit, with points in the target's order."""
        back = np.argsort(order)
        (seen,) = end.residuals
        assert seen.uv is not None
        seen = seen._replace(
            distance=seen.distance[back], weights=seen.weights[back], uv=seen.uv[back]
        )
        end = dataclasses.replace(end, residuals=(frame.measured(seen),))
        if not isinstance(end.model, Posed):
            return end
        end = dataclasses.replace(end, model=frame.back(end.model))
        return self.standard_form(end, names)


def _with_base_near(starts: Sequence[CloudStart], place: Float[np.ndarray, "3"]) -> CloudStart:
    """Of starts in a fitted pose, the one whose base is the nearest to a place."""

    def away(start: CloudStart) -> float:
        base = np.asarray(start.model(*start.model.domain.base))
        there = start.scale * start.rotation @ base + start.translation
        return float(np.linalg.norm(there - place))

    return min(starts, key=away)


def _temperature(near: DescentEnd, names: tuple[str, ...]) -> float:
    """The temperature at which the likelihood is used, per point, judged near the cloud."""
    end, sheet = near.end(), near.problem.sheet
    if not may_have_misfit(end, len(names)):
        return 0.0
    rows = rows_of(end, names, PointCloud(sheet.points))
    found = None if rows is None else discrepancy_of(rows)
    if rows is None or found is None:
        return 0.0
    total = float(np.sum(sheet.weights))
    return temperature(rows, found[1], total) / total


def _roughly(starts: list[DescentEnd]) -> list[DescentEnd]:
    """The ends of rough steps from the starts that may become the best, the best first."""
    if len(starts) > _LIKELY:
        starts = _promising(_stepped(starts, _FIRST))[:_LIKELY]
    return _promising(_stepped(starts, _ROUGH))


def _stepped(starts: list[DescentEnd], steps: int) -> list[DescentEnd]:
    """The ends of rough steps from some starts."""
    ends = []
    for start in starts:
        report(f"rough steps from {start.label}")
        ends.append(descend(start, steps, _NEAR))
    return ends


def _promising(near: list[DescentEnd]) -> list[DescentEnd]:
    """The ends of descents on the same points that may still become the best, the best first."""
    near = sorted(near, key=lambda end: end.chi2)
    best = near[0].point.cost
    # A step of √2k standard errors gains about k.
    return [end for end in near if end.point.cost - best < _HOPELESS + end.moved**2]


def _with_some(near: DescentEnd, scan: Scan, heat: float) -> DescentEnd:
    """An end near the one that all points have, by some of those that seem to belong to the surface."""
    some = np.flatnonzero(scan.likely)[:_SOME]
    sheet = Sheet(scan.points[some], scan.weights[some])
    return descend(near.with_cloud(sheet, _hot(heat, sheet)), _ROUNDS)


def _descended(near: DescentEnd, scan: Scan, heat: float, least: float, large: bool) -> Iterate:
    """The stationary point of the likelihood that is reached from beside the cloud.

    If points may be outliers, the descent goes on after each search for them. It is not followed further
    once it clearly will not reach the χ² of another end, `least`.

    Args:
        near: The end of rough steps.
        scan: The cloud.
        heat: The temperature per point.
        least: The χ² of another end.
        large: Whether the cloud is condensed for the steps.
    """
    points, weights, found = scan.points, scan.weights, None
    members = scan.likely.astype(float)
    if scan.background is not None:
        # Outliers are searched for among so many points; then all are judged by what was learned.
        some = slice(_SIFTED if large else None)
        kept, changed, number = members[some], 1.0, 0
        while changed > _UNCHANGED and number < _CLEARINGS:
            sheet = Sheet(points[some], weights[some] * kept)
            near = descend(near.with_cloud(sheet, _hot(heat, sheet)), _AGAIN)
            beside = sheet.beside(near.model, near.point.places)[:2]
            new = scan.background.mixture(near.model, *beside, weights[some], scan.noise)
            if not new.members.any():
                # The surface has left all points. It is judged by those that it was meant for.
                break
            found, changed = new, float(np.mean(np.abs(new.members - kept)))
            kept, number = new.members, number + 1
        if found is not None and len(kept) < len(points):
            beside = beside_many(near.model, points)[:2]
            found = scan.background.mixture(near.model, *beside, weights, scan.noise)
            kept = found.members
        members = kept if found is not None else members
    sheet = Sheet(points, weights * members)
    if large:
        near = _by_passes(near, sheet, _hot(heat, sheet), least)
    else:
        near = descend(near.with_cloud(sheet, _hot(heat, sheet)), _ROUNDS, least=least)
    end = dataclasses.replace(near.end(), mixture=found)
    if large:
        end = dataclasses.replace(end, points_used={"last steps": len(near.problem.sheet.points)})
    return end if found is None else likelier(end, scan)


def _by_passes(near: DescentEnd, sheet: Sheet, temperature: float, least: float) -> DescentEnd:
    """The stationary point of a large cloud: it is condensed where the last descent ended.

    An end that is clearly worse than another one, whose χ² is `least`, is not known so closely.
    """
    for cells in (COARSE, *[FINE] * _PASSES):
        before = near
        condensed = CondensedSheet.of(sheet, near.model, near.blur, cells)
        near = descend(near.with_cloud(condensed, temperature), _ROUNDS, _CLOSELY, least)
        if near.chi2 - least > _WORSE * np.sum(sheet.weights):
            break
        if cells is FINE and near.away(before) < _SAME:
            break
    return near


def _hot(heat: float, sheet: Sheet) -> float:
    """The temperature of a sheet for one per point, at least 1."""
    return max(heat * float(np.sum(sheet.weights)), 1.0)


def turned_over(
    end: Iterate, names: tuple[str, ...], over: AbstractSurface, sided: tuple[str, ...]
) -> Iterate:
    """An end with the parameters of the surface turned over, which is the same surface in space.

    Args:
        end: An end in a fitted pose; a half turn about its y axis turns the surface over.
        names: Names of all free parameters, including those of the pose.
        over: The surface turned over, in its own frame.
        sided: Names of its parameters that change their signs.
    """
    model = end.model
    assert isinstance(model, Posed)
    rotation = np.asarray(model.rotation) @ np.diag([-1.0, 1.0, -1.0])
    turn = (-model.turn_x, model.turn_y, -model.turn_z)
    shift = (model.shift_x, model.shift_y, model.shift_z)
    signs = np.where(np.isin(names, (*sided, "turn_x", "turn_z")), -1.0, 1.0)
    both = np.outer(signs, signs)
    frame = (in_doubles(over), rotation, model.origin, model.unit)
    return dataclasses.replace(
        end,
        model=Posed(*frame, model.scale, *shift, *turn),
        information=end.information * both,
        score_covariance=end.score_covariance * both,
        residuals=tuple(map(_seen_from_below, end.residuals)),
    )


def _seen_from_below(seen: Residuals) -> Residuals:
    """Residuals of points with their sides and places for the surface turned over."""
    if seen.uv is None:
        return seen
    return seen._replace(distance=-seen.distance, uv=seen.uv * [-1.0, 1.0])
