"""The summary of a fit: it turns the ends of the starts into values, errors, a status and warnings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from petalfit.components import (
    Parameter,
    Posed,
    bare,
    lengths,
    parameters,
    scales_with_lengths,
)
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.inference import verdict
from petalfit.fitting.inference.coverage import Coverage
from petalfit.fitting.inference.discrepancy import discrepancy_of
from petalfit.fitting.inference.identifiability import (
    combinations,
    covariance,
    few_points,
    known,
    posterior_of,
)
from petalfit.fitting.inference.linear_rows import may_have_misfit, rows_of
from petalfit.fitting.request.request import Request
from petalfit.fitting.result import FitResult
from petalfit.fitting.silhouettes.view_pose import turn_in_image, wrapped
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import AbstractObservation, PointCloud
from petalfit.results import (
    Agreement,
    FitWarning,
    Posterior,
    Start,
    WarningKind,
    in_order,
    standard_errors,
)
from petalfit.surfaces import AbstractSurface, Pose, value_at, with_value


def summarise(family: AbstractFamily, request: Request, ends: list[Iterate]) -> FitResult:
    """Makes the result of a fit from its ends.

    Args:
        family: The family of the model.
        request: The request, with the names and the pose that were fitted. The result has the values of
            its template if the best end is not finite.
        ends: The end of each start, the best first, with residuals in the order of the targets.
    """
    if request.is_one_image:
        ends = [ends[0], *(_seen_from(end, ends[0].model) for end in ends[1:])]
    best, template = ends[0], request.template
    names = request.free if family.named_errors else ()
    declared = _declared(best.model if family.named_errors else bare(template), names)
    agreements = _agreements(request.targets, best)
    doubt = _doubt(request, best, names)
    best = best.informed(1 / doubt)
    ends = [best, *ends[1:]]
    finite = bool(
        all(np.isfinite(float(value_at(best.model, name))) for name in declared)
        and best.is_finite
        and all(np.isfinite(part.distances).all() for part in agreements)
    )
    source = best.model if finite or isinstance(best.model, Posed) else template
    values = {name: float(value_at(source, name)) for name in declared}
    matrix, found = np.full((len(names), len(names)), np.inf), np.zeros(len(names), bool)
    by_noise, posterior, discrepancy = matrix, None, None
    if finite and names:
        judged = _same_way(ends) if request.is_one_image else ends
        found = known(judged, names, declared, family.hidden_from(request))
        added = None
        suspect = request.is_one_cloud and may_have_misfit(best, len(names))
        turned = request.is_one_cloud and request.pose != "known"
        rows = rows_of(best, names, request.cloud) if suspect or turned else None
        seen = discrepancy_of(rows) if suspect and rows is not None else None
        at_end = best
        if seen is not None:
            discrepancy, added = seen[0], seen[1] / doubt
        if rows is not None and (seen is not None or turned):
            # The rows belong to the pose in the target's frame, so that the information must too.
            told = 1.0 if best.mixture is None else best.mixture.certainty
            there = told * rows.information / doubt
            at_end = dataclasses.replace(best, information=there, score_covariance=there)
        matrix = covariance(at_end, names, declared, found, added)
        by_noise = covariance(at_end, names, declared, found)
        # From an unknown side, one outline shows no lengths: a bent surface may have the same.
        if not (request.pose != "known" and family.hidden_from(request)):
            posterior = posterior_of(at_end, names, declared, added)
    inflation = 1.0 if discrepancy is None else discrepancy.inflation
    identifiable = dict(zip(names, map(bool, found), strict=True))
    bounds = verdict.at_bounds(values, names, declared)
    in_image = isinstance(source, Posed) and request.pose == "known"
    in_space = isinstance(source, Posed) and not in_image
    # In a fitted pose, a parameter at its bound is no sign that the model was bent to reach its target.
    strained = not in_space and any(identifiable[n] for w in bounds for n in w.parameters)
    seen = _coverage(agreements, best.model) if finite else None
    misfits = _misfits(family, request, best, agreements, seen, strained)
    if any(misfits):
        # The errors belong to a petal that is not there.
        found, posterior, discrepancy = np.zeros(len(names), bool), None, None
        matrix = by_noise = np.full((len(names), len(names)), np.inf)
        identifiable = dict.fromkeys(names, False)
    status, reason = verdict.ending(best, finite, misfits, family.outcome(best))
    if isinstance(best.model, Posed) and in_space:
        # The poses of all ends are compared in the frame of the best one.
        ends = [best, *(_seen_from(end, best.model) for end in ends[1:])]
    starts = _starts(ends, names) if names else ()
    if isinstance(source, Posed) and in_image:
        placed = Posed.in_image
        factors = np.array([_pose_unit(n, source) if n in placed else 1.0 for n in names])
        matrix = by_noise = matrix * np.outer(factors, factors)
        values = values | _in_image(source)
        starts = tuple(
            dataclasses.replace(start, values=start.values | _in_image(end.model, source))
            for start, end in zip(starts, ends, strict=True)
            if isinstance(end.model, Posed)
        )
    warnings = [
        *verdict.about_targets(agreements),
        *(verdict.flips(best) if finite else []),
        *bounds,
        *verdict.not_determined(identifiable),
        *(combinations(best, names, declared, found) if finite and names else []),
        *verdict.rival_starts(starts, standard_errors(names, matrix), declared, inflation),
        *verdict.about_coverage(seen),
        *(w for part in agreements for w in verdict.about_distances(part, request.noise)),
        *(verdict.systematic(agreements[0], bare(best.model)) if finite else []),
    ]
    pose, pose_stderr = Pose.identity(), {}
    freedom = float(len(names)) if best.freedom is None else best.freedom
    if isinstance(source, Posed) and in_space:
        if request.pose == "rigid" and source.unit != 1 and scales_with_lengths(source.surface):
            unit = float(source.unit)
            scaled = lengths(source)
            factors = np.where(np.isin(names, scaled), unit, 1.0)
            squares = np.outer(factors, factors)
            matrix, by_noise = matrix * squares, by_noise * squares
            if posterior is not None:
                posterior = Posterior(posterior.names, posterior.covariance * squares)
            values = _times(values, scaled, unit)
            starts = tuple(
                dataclasses.replace(start, values=_times(start.values, scaled, unit))
                for start in starts
            )
            source = _with_unit_1(source)
        pose = source.placement
        errors = standard_errors(names, matrix)
        pose_stderr = {
            n: errors[n] * _pose_unit(n, source) for n in Posed.similarity if n in errors
        }
        own = [k for k, name in enumerate(names) if name not in Posed.similarity]
        names, matrix = tuple(names[k] for k in own), matrix[np.ix_(own, own)]
        by_noise = by_noise[np.ix_(own, own)]
        values = {name: x for name, x in values.items() if name not in Posed.similarity}
        identifiable = {name: identifiable[name] for name in names}
    elif isinstance(source, Posed):
        pose = source.placement
        warnings.append(_relative(pose))
    model = bare(source)
    for name in parameters(model):
        model = with_value(model, name, values[name])
    return FitResult(
        model=model,
        pose=pose,
        pose_stderr=pose_stderr,
        values=values,
        stderr=standard_errors(names, matrix),
        identifiable=identifiable,
        names=names,
        covariance=matrix,
        agreements=agreements,
        freedom=freedom,
        status=status,
        reason=reason,
        notes=(
            *(words for part in agreements for words in verdict.outliers(part)),
            *(
                []
                if discrepancy is None
                else [f"Errors allow for a misfit that {discrepancy.described}."]
            ),
            *_condensed(best),
            *verdict.symmetries(model),
        ),
        warnings=in_order(warnings),
        steps=best.rounds,
        starts=starts,
        posterior=posterior,
        trait_errors=best.trait_errors if finite else {},
        points_used=best.points_used,
        stderr_noise=standard_errors(names, by_noise),
        discrepancy=discrepancy,
        in_image=in_image,
    )


def _doubt(request: Request, best: Iterate, names: Sequence[str]) -> float:
    """The factor by which variances are larger than the information says."""
    doubt = 1.0
    if request.is_one_cloud and names and best.is_finite and request.noise is None:
        doubt = few_points(best, len(names))
    if best.moved > verdict.SETTLED:
        # The end may be as far away as the parameters still move.
        doubt *= 1 + best.moved**2
    return doubt


def _condensed(best: Iterate) -> list[str]:
    """A note if a large cloud was condensed for the steps of a fit."""
    used = best.points_used
    if not used:
        return []
    return [f"Steps took {used['last steps']:,} points, which stand for all {used['residuals']:,}."]


def _declared(model: AbstractSurface, names: Sequence[str]) -> dict[str, Parameter]:
    """Declarations of the result's parameters: those of the component and the free ones of a pose."""
    declared = parameters(model)
    if isinstance(model, Posed):
        held = set(Posed.similarity) - set(names)
        declared = {name: p for name, p in declared.items() if name not in held}
    return declared


def _agreements(targets: Sequence[AbstractObservation], best: Iterate) -> tuple[Agreement, ...]:
    return tuple(
        Agreement(
            target,
            part.distance,
            np.asarray(part.weights, float),
            part.noise,
            None if part.uv is None else np.asarray(part.uv, float),
        )
        for target, part in zip(targets, best.residuals, strict=True)
    )


def _misfits(
    family: AbstractFamily,
    request: Request,
    best: Iterate,
    parts: Sequence[Agreement],
    seen: Coverage | None,
    strained: bool,
) -> list[str]:
    """The reasons why the targets are no petal of this model; "" where there is none.

    Args:
        family: The family of the model.
        request: The request.
        best: The best end.
        parts: The targets with their distances from the model.
        seen: The parts of the model without points near them; None if that cannot be told.
        strained: Whether determined parameters ended at their bounds.
    """
    in_space = request.pose != "known"
    hides = bool(family.hidden_from(request))
    misfits = [
        verdict.misfit_of(part, strained, request.noise, in_space, best.left_out, hides)
        for part in parts
    ]
    if seen is None or not request.is_one_cloud:
        return misfits
    (part,) = parts
    # Where a fit was stopped far from its end says nothing about the outline that it may have.
    if best.moved <= verdict.NEARLY_SETTLED:
        pattern = verdict.systematic_rms(part, bare(best.model))
        misfits.append(
            verdict.misfit_of_outline(part, seen, pattern, not family.named_errors, in_space)
        )
        if family.is_petal:
            misfits.append(verdict.misfit_of_bays(seen))
    if family.is_petal and not any(misfits):
        misfits.append(verdict.misfit_of_turns(request.cloud.points[part.used]))
    return misfits


def _coverage(parts: Sequence[Agreement], model: AbstractSurface) -> Coverage | None:
    """The coverage of a surface by all clouds together; None if masks show its outline."""
    points = [x.target.points[x.used] for x in parts if isinstance(x.target, PointCloud)]
    if len(points) < len(parts):
        return None
    return Coverage.of(model, np.concatenate(points))


def _seen_from(end: Iterate, posed: AbstractSurface) -> Iterate:
    """An end with its pose relative to that of another model."""
    assert isinstance(end.model, Posed)
    assert isinstance(posed, Posed)
    return dataclasses.replace(end, model=end.model.seen_from(posed))


def _times(values: dict[str, float], names: Sequence[str], factor: float) -> dict[str, float]:
    """The values with those of some names multiplied by a factor."""
    return {name: x * factor if name in names else x for name, x in values.items()}


def _with_unit_1(posed: Posed) -> Posed:
    """The same surface at the same place, with its shifts counted in the target's unit.

    Its scale remains; the lengths of the component are to be multiplied by the former unit.
    """
    unit = float(posed.unit)
    return dataclasses.replace(
        posed,
        unit=np.float64(1.0),
        shift_x=unit * float(posed.shift_x),
        shift_y=unit * float(posed.shift_y),
        shift_z=unit * float(posed.shift_z),
    )


def _pose_unit(name: str, posed: Posed) -> float:
    """The factor from a pose's own unit of a parameter to the unit in the result."""
    return 1.0 if name.startswith("turn") else float(posed.unit)


def _starts(ends: list[Iterate], names: tuple[str, ...]) -> tuple[Start, ...]:
    return tuple(
        Start(
            end.label,
            {name: float(value_at(end.model, name)) for name in names},
            math.sqrt(np.average(end.residuals[0].distance ** 2, weights=end.residuals[0].weights)),
            end.chi2 - ends[0].chi2,
        )
        for end in ends
    )


def _relative(pose: Pose) -> FitWarning:
    text = (
        "without a camera lengths are relative: one unit of the model is "
        f"{float(pose.scale):.4g} pixels"
    )
    return FitWarning(text, WarningKind.RELATIVE_LENGTHS)


def _in_image(posed: Posed, other: Posed | None = None) -> dict[str, float]:
    """The place in an image: the scale in pixels a unit, shifts in pixels, and the turn from upright.

    Args:
        posed: A component that is seen from the front.
        other: Another one, from whose turn the turn differs by at most π; None for a turn of at most π.
    """
    placed = posed.placement
    right, down, _ = map(float, placed.translation)
    turn = turn_in_image(posed)
    if other is not None:
        near = turn_in_image(other)
        turn = near + wrapped(turn - near)
    return {"scale": float(placed.scale), "shift_x": right, "shift_y": down, "turn_z": turn}


def _same_way(ends: Sequence[Iterate]) -> list[Iterate]:
    """Of ends in an image, those of the same quarter as the first; else all.

    Which end of an outline is the base is decided by rule, so that its other way round is a rival, and no
    doubt about the values.
    """
    first = ends[0].model
    if not isinstance(first, Posed):
        return list(ends)
    turn = turn_in_image(first)
    return [
        end
        for end in ends
        if isinstance(end.model, Posed)
        and abs(wrapped(turn_in_image(end.model) - turn)) < 0.25 * math.pi
    ]
