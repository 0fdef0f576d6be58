"""The entry point for a whole flower: `fit_flower` finds its petals in one scan and fits each of them."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from petalfit.fitting.arrangement import regular_axis
from petalfit.fitting.error import FitError
from petalfit.fitting.families.registry import FOR_SCANS, family_of
from petalfit.fitting.fit import check_request, fit
from petalfit.fitting.flower_result import FlowerResult
from petalfit.fitting.parts import joined_parts
from petalfit.fitting.request.configuration import configuration
from petalfit.fitting.result import FitResult
from petalfit.fitting.segmentation import FEWEST, Segments, meeting_point, segments_of
from petalfit.fitting.segmentation.linkage import members_of
from petalfit.fitting.segmentation.members import NEAR, Sheet, memberships
from petalfit.fitting.shared import about_shared, check_shared, shared_spreads, with_common
from petalfit.fitting.siblings import Petal, like_siblings, placed_of
from petalfit.fitting.solver.observer import collect
from petalfit.fitting.thickets import without_thickets
from petalfit.observations import PointCloud, TargetError, as_point_cloud
from petalfit.observations.mesh_pieces import SEVERAL
from petalfit.results import FitWarning, Quantity, WarningKind
from petalfit.surfaces import AbstractSurface, Pose

MOST_PETALS = 60
SEEN = 12_000  # points that segments are found among
_FITTED = 600  # points that a petal is fitted to
_SMALL = 0.3  # of the median segment; a smaller one may be a part of others
_EXPLAINED = 0.7  # the part of its points that then lies on them
_ON_SHEETS = 0.5  # the share of the points in segments below which sheets cannot be told apart
_THICK = 0.25  # noise, in radii of neighbourhoods, from which points fill space
_LEFT_OUT = 0.1  # the share of the points in no petal that is worth a warning


def fit_flower(
    target: object,
    *,
    model: type[AbstractSurface] | AbstractSurface = FOR_SCANS,
    petals: int | None = None,
    loss: str = "robust",
    shared: Sequence[str] = (),
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    throw: bool = True,
) -> FlowerResult:
    """Recover the petals of a flower from one scan: their number, their points, their parameters.

    The scan is first segmented into smooth sheets. A petal is fitted to each of them, and then all points
    are assigned to the petals anew. A petal that is unlike the others is fitted again from where they
    would be in its place. Stalks, stamens and clutter that form no sheet belong to none.

    Args:
        target: A cloud of one flower in any position and unit: an (N, 3) array, a `PointCloud`, a trimesh
            mesh or cloud, or the path of a file.
        model: The class of the petals, or a petal whose fixed parameters are kept. Its family must allow
            any position and unit.
        petals: The number of petals, if it is known.
        loss: As in `fit`, for each petal.
        shared: Names of shape parameters that are the same for all petals. Each petal is fitted for
            itself, and then again with the means of what the petals determined.
        seed: The seed of random choices.
        progress: A function that is called with a line of text whenever a stage begins.
        throw: Whether to raise `FitError` if a fit failed; else `converged` of the result is False.

    Returns:
        The result. Read its `warnings`.

    Raises:
        TargetError: The cloud cannot be used: it is too sparse, has too many sheets, or none. Or a name
            in `shared` is that of no free shape parameter, or fewer than three petals determine it.
        FitError: The solver failed for a petal, and `throw` is True.
    """
    say = progress or (lambda text: None)
    check_request(model, pose="similarity", loss=loss, free=None, init=None, noise=None)
    shared = (shared,) if isinstance(shared, str) else tuple(shared)
    check_shared(model, shared)
    cloud = _scan(target, seed)
    _check_count(cloud, petals)
    say("telling the sheets apart")
    rng = np.random.default_rng(seed)
    seen = cloud.points[rng.permutation(len(cloud))[:SEEN]]
    found = segments_of(seen, petals, seed)
    _check_segments(found, petals)
    options = {"pose": "similarity", "loss": loss, "seed": seed, "throw": False}
    fitted = list(_fitted(seen, found, model, options, rng, petals is None, say))
    if not fitted:
        raise TargetError(
            "no petal could be fitted to any sheet of the cloud; crop it to the flower."
        )
    labels = found.labels
    if petals is None:
        fitted, labels = joined_parts(
            fitted, seen, labels, found.contacts, found.noise, _FITTED, model, options, rng, say
        )
    if "init" in family_of(model).takes:
        fitted = list(like_siblings(fitted, found.noise, model, options, say))
    if petals is None:
        fitted = without_thickets(fitted, seen, labels)
    spreads = shared_spreads([petal.result for petal in fitted], shared)
    common = {name: spread.mean for name, spread in spreads.items()}
    if common:
        fitted = list(_again(fitted, model, common, options, say))
    say("assigning the points")
    numbers = {petal.segment: number for number, petal in enumerate(fitted)}
    labels = np.array([numbers.get(label, -1) for label in labels.tolist()])
    sheets = [petal.sheet for petal in fitted]
    members = memberships(cloud.points, sheets, seen, labels, found.noise)
    result = _arranged(cloud, [petal.result for petal in fitted], members, found, petals)
    warnings = (*_warnings(result, found), *about_shared(spreads))
    result = dataclasses.replace(result, shared=common, warnings=warnings)
    failed = [petal for petal in result.petals if not petal.converged]
    if throw and failed:
        raise FitError(f"the fit of a petal failed: {failed[0].message}", failed[0])
    return result


def _scan(target: object, seed: int) -> PointCloud:
    """The cloud of a target; meshes are sampled densely enough to tell their sheets apart."""
    if isinstance(target, str | os.PathLike):
        return PointCloud.load(target, n=SEEN, seed=seed)
    if hasattr(target, "faces") and hasattr(target, "vertices"):
        return PointCloud.from_mesh(target, SEEN, seed)  # pyright: ignore[reportArgumentType]
    return as_point_cloud(target)


def _check_count(cloud: PointCloud, petals: int | None) -> None:
    if len(cloud) < FEWEST:
        raise TargetError(
            f"{len(cloud)} points are too few to tell the petals of a flower apart; scan it with "
            f"{FEWEST} or more, better some thousand."
        )
    if petals is not None and not 1 <= petals <= min(MOST_PETALS, len(cloud) // 50):
        raise TargetError(
            f"petals={petals} is no number of petals for {len(cloud):,} points; give 1 to "
            f"{min(MOST_PETALS, len(cloud) // 50)}, or leave it out."
        )


def _check_segments(found: Segments, petals: int | None) -> None:
    on = float(np.mean((found.labels >= 0) | found.table | found.tubes))
    if on < _ON_SHEETS or found.thickness > _THICK:
        raise TargetError(
            "the points do not lie on smooth sheets that their neighbours continue: the cloud "
            "is too sparse or too noisy to tell the petals apart; scan it more densely, or crop it to "
            "one flower."
        )
    if found.count > MOST_PETALS:
        raise TargetError(
            f"the cloud has {found.count} separate sheets, where a flower has at most {MOST_PETALS} "
            "petals here: crop it to one flower."
        )
    if petals is not None and found.count != petals:
        raise TargetError(
            f"the cloud shows {found.count} sheets, which cannot be cut to {petals} petals: give the "
            "number that you see, or leave petals out."
        )


def _fitted(
    seen: Float[np.ndarray, "n 3"],
    found: Segments,
    model: type[AbstractSurface] | AbstractSurface,
    options: Mapping[str, Any],
    rng: np.random.Generator,
    may_drop: bool,
    say: Callable[[str], None],
) -> Iterator[Petal]:
    """A petal for each segment, the largest first; small ones that others explain are none."""
    inside = members_of(found.labels)
    sizes = np.array([len(part) for part in inside])
    if found.count > 1 and "base" in family_of(model).takes:
        options = {**options, "base": meeting_point([seen[part] for part in inside])}
    sheets: list[Sheet] = []
    for number, segment in enumerate(np.argsort(-sizes).tolist()):
        points = seen[inside[segment]]
        if may_drop and sheets and len(points) < _SMALL * np.median(sizes):
            near = np.min([sheet.distance(points) for sheet in sheets], axis=0) < NEAR * found.noise
            if np.mean(near) > _EXPLAINED:
                continue
        some = points[rng.permutation(len(points))[:_FITTED]]
        stage = f"petal {number + 1} of {found.count}"
        say(stage)
        try:
            result = fit(
                model, some, progress=lambda text, stage=stage: say(f"{stage}: {text}"), **options
            )
        except TargetError:
            continue  # no petal has such a shape
        assert isinstance(result, FitResult)
        petal = Petal.of(segment, some, result)
        sheets.append(petal.sheet)
        collect(result)
        yield petal


def _again(
    fitted: Sequence[Petal],
    model: type[AbstractSurface] | AbstractSurface,
    common: Mapping[str, Quantity],
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> Iterator[Petal]:
    """The petals, fitted again from where they are with common values of some parameters."""
    free = [name for name in configuration(model, None, None)[1] if name not in common]
    for number, petal in enumerate(fitted):
        stage = f"petal {number + 1} of {len(fitted)} with what all share"
        say(stage)
        result = fit(
            model,
            petal.points,
            free=free,
            init=with_common(petal.result, common),
            progress=lambda text, stage=stage: say(f"{stage}: {text}"),
            **options,
        )
        assert isinstance(result, FitResult)
        yield petal.with_result(result)


def _arranged(
    cloud: PointCloud,
    petals: list[FitResult],
    members: Float[np.ndarray, "n k"],
    segments: Segments,
    given: int | None,
) -> FlowerResult:
    """The result, its petals in the order of their layout."""
    placed = placed_of(petals)
    axis, found = regular_axis(placed)
    order = found.order
    members = members[:, order]
    labels: Int[np.ndarray, " n"] = np.where(
        members.max(axis=1) > 1 - members.sum(axis=1), members.argmax(axis=1), -1
    )
    scale = float(np.median([float(petal.pose.scale) for petal in petals]))
    rivals = () if given is not None else segments.rivals
    dropped = segments.count - len(petals)
    return FlowerResult(
        target=cloud,
        petals=tuple(petals[k] for k in order),
        labels=labels,
        memberships=members,
        axis=Pose(axis.axes, axis.origin, scale),
        layout=found.layout,
        rivals=tuple(rival - dropped for rival in rivals if rival > dropped),
    )


def _warnings(result: FlowerResult, segments: Segments) -> Iterator[FitWarning]:
    for note in result.target.notes:
        if SEVERAL in note:
            continue  # they are the petals
        yield FitWarning(f"{note[0].upper()}{note[1:].removesuffix('.')}.", WarningKind.TARGET)
    if result.count == 1:
        yield FitWarning(
            "There is only one petal in the cloud; fit_petal is made for that.", WarningKind.COUNT
        )
    elif result.rivals:
        numbers = " or ".join(map(str, result.rivals))
        yield FitWarning(
            f"The cloud may also show {numbers} petals, where {result.count} were found: look at the "
            "picture, and give the number that you see as petals.",
            WarningKind.COUNT,
        )
    none = float(np.mean(result.labels < 0))
    if none > _LEFT_OUT:
        text = f"{100 * none:.0f} % of the points belong to no petal and are left out"
        yield FitWarning(f"{text}{_organs(segments)}.", WarningKind.LEFT_OUT)
    for name, petal in zip(result.names, result.petals, strict=True):
        if not petal.converged:
            yield FitWarning(
                f"The fit of {name} did not converge: {petal.outcome}.", WarningKind.SYSTEMATIC
            )


def _organs(segments: Segments) -> str:
    """What the points that belong to no petal lie on, as far as that is clear."""
    kinds = {
        "on a flat sheet larger than any petal, as a table is": segments.table,
        "on tubes, as stalks and pistils are": segments.tubes,
    }
    parts = [f"{100 * np.mean(on):.0f} % {what}" for what, on in kinds.items() if np.any(on)]
    return f": {'; '.join(parts)}" if parts else ""
