"""Joint fits: silhouettes, clouds and other observations in one likelihood."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from petalfit.compilation import stage
from petalfit.components import Posed, parameters, scales_with_lengths
from petalfit.fitting.coordinates import Coordinates, Prior, with_values
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.inference.identifiability import sizes
from petalfit.fitting.inference.pinning import pinned
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.observed import AbstractObserved
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.request.request import Request
from petalfit.fitting.silhouettes.hidden import allowing_for_hidden
from petalfit.fitting.silhouettes.observing import Part, observe
from petalfit.fitting.solver.all_points import with_all_points
from petalfit.fitting.solver.alternate import minimise
from petalfit.fitting.solver.debias import evaluate, without_bias
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import report
from petalfit.fitting.starts.support import Shadow, search
from petalfit.observations import PointCloud, TargetError
from petalfit.surfaces import AbstractSurface, value_at

_CANDIDATES = 20
# A candidate with a misfit below this is right, and no further one is tried.
_RIGHT = 0.03
_FOLLOWED = 3
# An approach goes on while the misfit falls to less than this fraction.
_NEARER = 0.7
_ROUNDS, _LAST_ROUNDS = 20, 40
_TOLERANCE = 2e-2
# Number of scales that are tried for a mask without a camera.
_SCALES = 25
# Two outlines count as the same if no coordinate differs by more than this.
_SAME = 0.3

Start = tuple[str, AbstractSurface]


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint fit: all observations, and methods that solve for them from a start.

    Attributes:
        family: The family of the model.
        coordinates: The free parameters.
        parts: The likelihoods of the observations, each with the indices of its targets.
        hidden: Names of parameters that the observations cannot show, which are held.
    """

    family: AbstractFamily
    coordinates: Coordinates
    parts: tuple[Part, ...]
    hidden: tuple[str, ...] = ()

    @classmethod
    def of(cls, family: AbstractFamily, request: Request) -> Joint:
        """The joint fit that is asked for, in the frame of the request's template."""
        coordinates = Coordinates.of(request.template, request.free)
        return cls(family, coordinates, observe(request), family.hidden_from(request))

    def in_frame(self, frame: AbstractSurface) -> Joint:
        """The same joint fit in the frame of another template."""
        coordinates = Coordinates.of(frame, self.coordinates.free)
        return dataclasses.replace(self, coordinates=coordinates)

    @property
    def observed(self) -> list[AbstractObserved]:
        """The likelihoods of all observations, without the indices."""
        return [part.observed for part in self.parts]

    @property
    def clouds(self) -> list[ObservedCloud]:
        """The clouds among them."""
        return [x for x in self.observed if isinstance(x, ObservedCloud)]

    @property
    def views(self) -> ObservedViews | None:
        """The silhouettes among them, together; None if there are none."""
        return next((x for x in self.observed if isinstance(x, ObservedViews)), None)

    def minimise(
        self,
        coordinates: Coordinates,
        model: AbstractSurface,
        rounds: int = _ROUNDS,
        tolerance: float = _TOLERANCE,
        prior: Prior | None = None,
    ) -> Iterate:
        """Minimises the cost from a model; everything is matched again before each round."""
        terms = [None] * len(self.parts)
        return minimise(coordinates, self.observed, model, terms, rounds, tolerance, prior, every=1)

    def misfit(self, model: AbstractSurface) -> float:
        """The sum of all misfits, by which starts are chosen; small if a model follows the targets."""
        return sum(part.misfit(model) for part in self.observed)

    def follow(self, label: str, model: AbstractSurface, held: tuple[str, ...] = ()) -> Followed:
        """Solves from a start, with some parameters held beside the hidden ones."""
        held = (*held, *self.hidden)
        report(f"polishing from {label}")
        with stage("polishing"):
            coordinates = self.coordinates.holding(held).around(model)
            end = self.minimise(coordinates, model, _LAST_ROUNDS)
        return Followed(self, end, evaluate(self.coordinates, label, self.observed, end), held)


@dataclasses.dataclass(frozen=True)
class Followed:
    """A start that was followed to its end.

    Attributes:
        joint: The joint fit, in the frame in which it was followed.
        left: The end as the solver left it.
        end: The end with its evaluation.
        held: Names of the parameters that were held.
    """

    joint: Joint
    left: Iterate
    end: Iterate
    held: tuple[str, ...]

    @property
    def cost(self) -> float:
        """The χ² of the end, by which ends are compared; infinite if it has none."""
        return self.end.chi2 if np.isfinite(self.end.chi2) else np.inf

    def labelled(self, prefix: str) -> Followed:
        """The same with words before its label."""
        label = f"{prefix}, {self.end.label}"
        return dataclasses.replace(self, end=dataclasses.replace(self.end, label=label))


def fit_joint(family: AbstractFamily, request: Request) -> list[Iterate]:
    """Fit a component to several observations, or to silhouettes, in its own frame.

    Call it inside `jax.enable_x64(True)`.

    Args:
        family: The family of the template.
        request: The request; its free names include those of a pose around the template.

    Returns:
        The end of each start, the best first, with residuals in the order of the targets.
    """
    found = follow(Joint.of(family, request), request)
    return finish(request, sorted(found, key=lambda one: one.cost))


def follow(joint: Joint, request: Request, found: tuple[str, ...] = ()) -> list[Followed]:
    """The ends of all starts of a joint fit.

    Args:
        joint: The joint fit.
        request: What is asked for.
        found: Names of the parameters that the template already has nearly right: the search for starts
            keeps them.
    """
    if request.from_template:
        return [joint.follow("given", joint.coordinates.template)]
    return [*_from_clouds(joint, request), *_from_outlines(joint, found)]


def approach(joint: Joint, views: ObservedViews, model: AbstractSurface) -> list[Followed]:
    """The ends of a model that may be near the silhouettes; none if they are not reached soon."""
    report("approaching the outline")
    rough, held = _roughly(joint)
    misfit, before = joint.misfit(model), np.inf
    while misfit >= _RIGHT:
        if not misfit < _NEARER * before:
            return []
        before = misfit
        model = joint.minimise(rough.around(model), model).model
        misfit = joint.misfit(model)
    return [*_polished(joint, views, "nearest outline", model, held)]


def finish(request: Request, found: Sequence[Followed]) -> list[Iterate]:
    """Corrects the bias of the first of several ends, and finds its errors.

    Returns:
        All ends in the given order, with residuals in the order of the targets.
    """
    best, *others = found
    joint, coordinates, free = best.joint, best.joint.coordinates, request.free
    parts = joint.parts
    rest = [_in_order(other.end, parts) for other in others]
    if request.ends_only:
        return [_in_order(best.end, parts), *rest]

    def finished(end: Iterate, prior: Prior | None = None) -> Iterate:
        known = Prior.none(len(free)) if prior is None else prior
        # Held parameters do not move: their prior is very narrow.
        root = np.where(np.isin(free, best.held), 1e6, known.root)
        around, label = coordinates.around(end.model), best.end.label
        return without_bias(around, label, joint.observed, end, Prior(known.centre, root))

    def again(model: AbstractSurface, prior: Prior) -> Iterate:
        held = coordinates.holding(best.held).around(model)
        return finished(joint.minimise(held, model, prior=prior), prior)

    report("taking pictures of the fit")
    with stage("errors"):
        final = pinned(coordinates, finished(best.left), again)
        if joint.hidden and joint.views is not None and not request.is_one_image:
            (view,) = joint.views.views
            final = allowing_for_hidden(coordinates, view, final, joint.hidden)
    final = _in_order(dataclasses.replace(final, chi2=best.end.chi2), parts)
    for number, target in enumerate(request.targets):
        if isinstance(target, PointCloud):
            final = with_all_points(final, number, target)
    return [final, *rest]


def _in_order(end: Iterate, parts: Sequence[Part]) -> Iterate:
    """An end with its residuals in the order of the targets."""
    numbers = [number for part in parts for number in part.numbers]
    residuals = tuple(end.residuals[k] for k in np.argsort(numbers))
    return dataclasses.replace(end, residuals=residuals)


def _from_clouds(joint: Joint, request: Request) -> Iterator[Followed]:
    """Ends from starts that a fit to the clouds alone gives."""
    clouds = [target for target in request.targets if isinstance(target, PointCloud)]
    count = sum(np.count_nonzero(cloud.mass) for cloud in clouds)
    if count < len(request.free) + 1:
        if clouds and joint.views is None:
            raise TargetError(
                f"{count} points cannot determine {len(request.free)} free "
                "parameters: give more points, or name fewer parameters in free."
            )
        return
    points = np.concatenate([cloud.points for cloud in clouds])
    whole = PointCloud(points, weights=np.concatenate([cloud.mass for cloud in clouds]))
    alone = dataclasses.replace(request, targets=(whole,))
    for start in joint.family.fit_cloud(alone):
        yield joint.follow(start.label, start.model)


def _from_outlines(joint: Joint, found: tuple[str, ...]) -> Iterator[Followed]:
    """Ends of rough starts that follow the silhouettes, and of refined ones that are made from them."""
    if joint.views is None:
        return
    rough, held = _roughly(joint)
    for label, model in _outlined(joint, joint.views, rough, (*found, *joint.family.late)):
        yield from _polished(joint, joint.views, label, model, held)


def _polished(
    joint: Joint,
    views: ObservedViews,
    label: str,
    model: AbstractSurface,
    held: tuple[str, ...],
) -> Iterator[Followed]:
    """The end of a rough model that follows the silhouettes, and of refined starts made from it."""
    yield joint.follow(label, model, held)
    for name, start in joint.family.refined(joint.coordinates, model, joint.clouds, views):
        yield joint.follow(name, start)


def _roughly(joint: Joint) -> tuple[Coordinates, tuple[str, ...]]:
    """Coordinates for a rough fit to outlines, and the names of the parameters that the family holds."""
    rough = joint.family.rough(joint.coordinates)
    held = tuple(name for name in rough.free if name not in rough.moving)
    return rough.holding((*held, *joint.hidden)), held


def _outlined(
    joint: Joint, views: ObservedViews, rough: Coordinates, late: tuple[str, ...]
) -> Iterator[Start]:
    """Different surfaces that follow the silhouettes, with their labels, the best first.

    Args:
        joint: The joint fit.
        views: Its silhouettes.
        rough: The coordinates in which the surfaces are found.
        late: Names of parameters that are held until the surfaces nearly follow the silhouettes.
    """
    report("searching the outline")
    first = rough.holding([*late, *(name for name in rough.free if name not in rough.moving)])
    shadows = [Shadow.of(view.contour) for view in views.views]
    found: list[tuple[float, AbstractSurface]] = []
    for t, _ in search(first, shadows, _CANDIDATES):
        model = joint.minimise(first, first.model(t), 3, 0.5).model
        found.append((joint.misfit(model), model))
        if found[-1][0] < _RIGHT:
            break
    found.sort(key=lambda start: start[0])
    least, _ = found[0]
    promising = [model for misfit, model in found[:_FOLLOWED] if is_promising(misfit, least)]
    best = promising[0]
    has_scale = isinstance(best, Posed) and "scale" in rough.moving
    if isinstance(best, Posed) and has_scale and not scales_with_lengths(best.surface):
        promising = _rescaled(joint, rough, best)
    ends = [joint.minimise(rough, model).model for model in promising]
    ends.sort(key=joint.misfit)
    different: list[Float[np.ndarray, " p"]] = []
    for model in ends:
        t = rough.inverse(model)
        if all(np.max(np.abs(t - other)) > _SAME for other in different):
            different.append(t)
            yield f"outline {len(different)}", model


def is_promising(misfit: float, least: float) -> bool:
    """Whether a start with a misfit may still become the best, given the least misfit of all."""
    return misfit <= 3 * least + _RIGHT


def _rescaled(joint: Joint, rough: Coordinates, model: Posed) -> list[AbstractSurface]:
    """Models with nearly the same outline at other scales; only lengths that are fixed differ then."""
    lengths = [name for name in sizes(model) if name in rough.free]
    found: list[tuple[float, AbstractSurface]] = []
    for factor in np.geomspace(0.4, 2.5, _SCALES):
        values = {name: float(value_at(model, name)) * factor for name in lengths}
        typical = [parameters(model)[name].typical for name in lengths]
        if not all(
            0.8 * low < value < 1.25 * high
            for value, (low, high) in zip(values.values(), typical, strict=True)
        ):
            continue
        other = with_values(model, values | {"scale": model.scale / factor})
        other = joint.minimise(rough, other, 4, 0.2).model
        found.append((joint.misfit(other), other))
    found.sort(key=lambda start: start[0])
    return [other for _, other in found[: 2 * _FOLLOWED]] or [model]
