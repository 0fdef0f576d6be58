"""Families of open surfaces in any pose, brought near a cloud from a few starts and settled there."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import ClassVar, TypeVar

import numpy as np
from jaxtyping import Float

from petalfit.compilation import stage
from petalfit.components import Posed
from petalfit.fitting.coordinates import Coordinates, in_doubles, with_values
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.polish import likelier
from petalfit.fitting.inference.discrepancy import discrepancy_of, temperature
from petalfit.fitting.inference.linear_rows import may_have_misfit, rows_of
from petalfit.fitting.likelihood.cloud import ObservedCloud, pad
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.request.checks import POSES
from petalfit.fitting.request.request import Request, scan_of
from petalfit.fitting.solver.all_points import with_all_points
from petalfit.fitting.solver.debias import evaluate
from petalfit.fitting.solver.descent import HELD, HELD_BACK, Descent, terms_of
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import report
from petalfit.fitting.solver.settle import settle
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.observations import PointCloud
from petalfit.surfaces import AbstractSurface, value_at

# Numbers of points for the search for starts, and for rough steps.
_SOME = 1536
_ROUGHLY = 768
_FOLLOWED = 2
_ROUGH, _NEAR = 10, 10  # steps, after which the likelihood of a sheet takes over
_FEW = 2  # steps with all points of a large cloud
_ROUNDS = 100  # evaluations of that likelihood at most
# A start whose χ² is worse than the best's by more than this after rough steps is not followed.
_HOPELESS = 0.2  # of the number of points
_SETTLED = 0.3  # √χ² of a step's gain
_FAR = 0.012  # noise, relative to the extent, beyond which the surface may be in the wrong place
_CLEARINGS, _AGAIN = 3, 6  # searches for outliers, and steps after each of them
_UNCHANGED = 0.002  # a smaller mean change of the probabilities is none


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

    A subclass defines its `kind`, `gauges` and `held_at_first`, and the method `starts`. Its models can
    then be fitted in every pose, with every loss.

    Attributes:
        held_at_first: Names of parameters that rough steps hold, because they mean nothing before the
            other parameters are nearly right.
    """

    poses: ClassVar[tuple[str, ...]] = POSES
    takes: ClassVar[frozenset[str]] = AbstractFamily.takes | {"base"}
    held_at_first: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def starts(
        self,
        template: AbstractSurface,
        free: tuple[str, ...],
        points: Float[np.ndarray, "n 3"],
        pose: str,
    ) -> Sequence[CloudStart]:
        """Starts for a cloud, the likeliest first; the first two are followed.

        Args:
            template: A model with the values of the parameters that are not free.
            free: Names of the free parameters, without the gauge and those of the pose.
            points: Points in the cloud's normalised frame; most of them belong to the surface.
            pose: "known": rotation and translation of a start are not used. "rigid": the model has the
                unit of the cloud, and the start has scale 1. "similarity": all of them are used.
        """

    def labels(self, starts: Sequence[CloudStart]) -> list[str]:
        """The labels of the ends in a result, given their starts, with that of the best end first."""
        return [start.label for start in starts]

    def standard_form(self, end: Iterate, names: tuple[str, ...]) -> Iterate:
        """The end in standard form, if several sets of parameters describe the same surface.

        Args:
            end: An end in a fitted pose.
            names: Names of all free parameters, including those of the pose.
        """
        del names
        return end

    def fit_cloud(self, request: Request) -> list[Iterate]:
        used = request.cloud.mass > 0
        frame = NormalisedFrame.of(request.cloud.points[used], request.pose)
        scan, order = scan_of(request, frame, True)
        sheets, masses = scan.points[scan.likely], scan.weights[scan.likely]
        names = self.free_in(request.pose, request.free)
        starts: list[tuple[str, AbstractSurface]] = [("given", request.template)]
        found: Sequence[CloudStart] = ()
        if not request.from_template:
            report("flattening the cloud")
            redundant = self.gauges.get(request.pose, ())
            free = tuple(name for name in request.free if name not in redundant)
            every = self.starts(request.template, free, sheets[:_SOME], request.pose)
            if request.base is not None:
                every = [_with_base_near(every, frame.into(np.array([request.base]))[0])]
            found = every[:_FOLLOWED]
            starts = [(start.label, start.posed(request.pose)) for start in found]
        some = masses[:_ROUGHLY]
        rough = Descent.of(sheets[:_ROUGHLY], some, scan.noise, np.ones(len(some)))
        near: list[Iterate] = []
        for label, model in starts:
            report(f"rough steps from {label}")
            coordinates = Coordinates.of(model, names).holding(self.held_at_first)
            end = rough.descend(coordinates, model, _ROUGH, 3.0)
            near.append(dataclasses.replace(end, label=label))
        near.sort(key=lambda end: end.chi2)
        beside: list[Iterate] = []
        for start in near:
            if start.chi2 - near[0].chi2 < _HOPELESS * len(rough.cloud.data.points):
                report(f"approaching from {start.label}")
                with stage("polishing"):
                    beside.append(_beside(Coordinates.of(start.model, names), start, scan))
        beside.sort(key=lambda end: end.chi2)
        heat = _temperature(beside[0], names, scan)
        ends: list[Iterate] = []
        for end in beside:
            report(f"polishing from {end.label}")
            least = min((other.chi2 for other in ends), default=np.inf)
            with stage("polishing"):
                ends.append(_settled(end, names, scan, heat, least))
        ends.sort(key=lambda end: end.chi2)
        if found:
            by_label = {start.label: start for start in found}
            labels = self.labels([by_label[end.label] for end in ends])
            ends = [dataclasses.replace(e, label=x) for e, x in zip(ends, labels, strict=True)]
        ends = [self._in_target(end, names, frame, order) for end in ends]
        coordinates = Coordinates.of(ends[0].model, names)
        return [with_all_points(coordinates, ends[0], 0, request.cloud), *ends[1:]]

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
    """Of starts in a fitted pose, the one whose base is the nearest to a place.

    The base is the middle of the side where v is least.
    """

    def away(start: CloudStart) -> float:
        (u_low, u_high), (v_low, _) = start.model.domain
        base = np.asarray(start.model(0.5 * (u_low + u_high), v_low))
        there = start.scale * start.rotation @ base + start.translation
        return float(np.linalg.norm(there - place))

    return min(starts, key=away)


def _descended(
    coordinates: Coordinates,
    model: AbstractSurface,
    scan: Scan,
    steps: int = _NEAR,
    held: float = HELD,
) -> Iterate:
    """Descends from a model; if points may be outliers, again after each search for them."""
    points, weights, members = scan.points, scan.weights, scan.likely.astype(float)
    descent = Descent.of(points, weights, scan.noise, members)
    end = descent.descend(coordinates, model, steps, _SETTLED, held)
    if scan.background is None:
        return end
    clearings, rounds = 0, end.rounds
    while True:
        model, clearings = end.model, clearings + 1
        beside = descent.cloud.beside(coordinates, coordinates.inverse(model), terms_of(end)[0])
        found = scan.background.mixture(model, *beside, weights, scan.noise)
        changed, members = float(np.mean(np.abs(found.members - members))), found.members
        descent = Descent.of(points, weights, scan.noise, members)
        end = descent.descend(coordinates, model, _AGAIN, _SETTLED)
        rounds += end.rounds
        if changed < _UNCHANGED or clearings == _CLEARINGS:
            return dataclasses.replace(end, rounds=rounds, mixture=found)


def _beside(coordinates: Coordinates, start: Iterate, scan: Scan) -> Iterate:
    """Brings a start beside the cloud, with some of the points first, then with all."""
    number, model, steps = 0, start.model, _NEAR
    if len(scan.points) > 2 * _SOME:
        near = _descended(coordinates, model, scan.first(_SOME))
        model, number, steps = near.model, near.rounds, _FEW
    end = _descended(coordinates, model, scan, steps)
    if float(terms_of(end)[0].sigma) > _FAR * np.linalg.norm(np.ptp(scan.points, axis=0)):
        # The descent may have ended in a wrong minimum, which shorter steps may avoid.
        other = _descended(coordinates, model, scan, steps, HELD_BACK)
        end = min(end, other, key=lambda end: end.chi2)
    cloud = terms_of(end)[0]
    end = dataclasses.replace(end, rounds=number + end.rounds, terms=(cloud,))
    return _trimmed(evaluate(coordinates, start.label, [ObservedCloud(cloud.data)], end), scan)


def _temperature(end: Iterate, names: tuple[str, ...], scan: Scan) -> float:
    """The temperature at which the likelihood is used, judged by the distances beside the cloud."""
    if not may_have_misfit(end, len(names)):
        return 1.0
    rows = rows_of(end, names, PointCloud(scan.points))
    found = None if rows is None else discrepancy_of(rows)
    if rows is None or found is None:
        return 1.0
    return temperature(rows, found[1], float(np.sum(end.residuals[0].weights)))


def _settled(
    end: Iterate, names: tuple[str, ...], scan: Scan, heat: float, least: float
) -> Iterate:
    """The stationary point of the likelihood that is reached from beside the cloud.

    It is not followed further once it clearly will not reach the χ² of another end, `least`.
    """
    weights, noise = end.residuals[0].weights, float(end.terms[0].sigma)
    model, rounds = end.model, end.rounds
    if len(scan.points) > 2 * _SOME:
        # Some of the points bring it within a few errors of the end that all of them have.
        some = pad(scan.points[:_SOME], weights[:_SOME], scan.noise)
        share = float(np.sum(weights[:_SOME]) / np.sum(weights))
        near = settle(model, names, some, noise, max(heat * share, 1.0), _ROUNDS, end.label)
        model, noise, rounds = near.model, float(near.terms[0].sigma), rounds + near.rounds
    data = pad(scan.points, weights, scan.noise)
    settled = settle(model, names, data, noise, heat, _ROUNDS, end.label, least)
    settled = dataclasses.replace(settled, rounds=rounds + settled.rounds, mixture=end.mixture)
    return _trimmed(settled, scan)


def _trimmed(end: Iterate, scan: Scan) -> Iterate:
    """The end without padding, and with the likelihood of its mixture if points may be outliers."""
    (seen,) = end.residuals
    assert seen.uv is not None
    n = len(scan.points)
    seen = seen._replace(distance=seen.distance[:n], weights=seen.weights[:n], uv=seen.uv[:n])
    end = dataclasses.replace(end, residuals=(seen,))
    return end if end.mixture is None else likelier(end)


def turned_over(
    end: Iterate, names: tuple[str, ...], over: AbstractSurface, sided: tuple[str, ...]
) -> Iterate:
    """An end with the parameters of the surface turned over, which is the same surface in space.

    Args:
        end: An end in a fitted pose; a half turn about its y axis turns the surface over.
        names: Names of all free parameters, including those of the pose.
        over: The surface turned over, in its own frame.
        sided: Names of the parameters that change their signs. Those of the pose, which are nuisance
            parameters, may keep theirs.
    """
    model = end.model
    assert isinstance(model, Posed)
    rotation = np.asarray(model.rotation) @ np.diag([-1.0, 1.0, -1.0])
    signs = np.where(np.isin(names, sided), -1.0, 1.0)
    both = np.outer(signs, signs)
    (seen,) = end.residuals
    assert seen.uv is not None
    seen = seen._replace(distance=-seen.distance, uv=seen.uv * [-1.0, 1.0])
    return dataclasses.replace(
        end,
        model=Posed(in_doubles(over), rotation, model.origin, model.unit),
        information=end.information * both,
        score_covariance=end.score_covariance * both,
        residuals=(seen,),
    )
