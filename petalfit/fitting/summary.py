"""From where the starts ended to a result: values, errors, and words for what they do not say."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from petalfit.components import Parameter, Posed, bare, parameters
from petalfit.fitting.determined import combinations, covariance
from petalfit.fitting.estimate import Start, rivals, standard_errors
from petalfit.fitting.kernels import spread_of
from petalfit.fitting.result import Agreement, FitResult
from petalfit.fitting.rounds import Settled
from petalfit.observations import PointCloud, Silhouette
from petalfit.surfaces import AbstractSurface, Pose, is_of_revolution, value_at, with_value

# Distances of more than this fraction of a target's size are no noise.
_MISFIT = 0.02
# And of less, if the model had to be bent to the bounds of its parameters.
_STRAINED_MISFIT = 0.005
_GROSS = 6.0  # in units of the noise
_EMPTY = 0.1
_ROUNDING = 1e-6  # of a target's size: less is no distance
_MOSTLY_STRAYS = 0.6  # of the points
# Where foot points jump between two folds, a fit may flip for ever between two states that are nearly
# the same: up to this many standard errors apart, that is a warning and no failure.
_SETTLED = 0.5


def summarise(
    template: AbstractSurface,
    names: tuple[str, ...],
    targets: Sequence[PointCloud | Silhouette],
    ends: list[Settled],
    noise: float | None,
) -> FitResult:
    """The result of a fit.

    Args:
        template: Values for the case that the best end is not finite.
        names: The free parameters.
        targets: In the order of the ends' observations.
        ends: What each start reached, the best first.
        noise: Of the clouds, if it was given.
    """
    best = ends[0]
    declared = parameters(template)
    if isinstance(template, Posed):
        held = set(Posed.similarity) - set(names)
        declared = {name: p for name, p in declared.items() if name not in held}
    agreements = [
        Agreement(
            target,
            part.distance,
            np.asarray(part.weights, float),
            part.noise,
            None if part.uv is None or part.unit == "px" else np.asarray(part.uv, float),
        )
        for target, part in zip(targets, best.seen, strict=True)
    ]
    finite = bool(
        all(np.isfinite(float(value_at(best.model, name))) for name in declared)
        and np.isfinite(best.information).all()
        and all(np.isfinite(part.distances).all() for part in agreements)
    )
    source = best.model if finite else template
    values = {name: float(value_at(source, name)) for name in declared}
    if finite:
        matrix, found = covariance(ends, names, declared)
    else:
        matrix, found = np.full((len(names), len(names)), np.inf), np.zeros(len(names), bool)
    identifiable = dict(zip(names, map(bool, found), strict=True))
    bounds = at_bounds(values, names, declared)
    # In a pose of its own a model need not be bent to reach its target.
    in_space = isinstance(source, Posed) and "turn_x" in names
    strained = not in_space and any(identifiable[name] for name in bounds)
    misfits = [_misfit(part, strained, noise, in_space) for part in agreements]
    settled = finite and bool(best.moved <= _SETTLED)
    if not finite:
        status, message = "not_finite", "the solver met values that are not finite"
    elif any(misfits):
        status, message = "misfit", next(filter(None, misfits))
    elif settled:
        status, message = "converged", f"converged after {best.rounds} rounds"
    else:
        status = "round_limit"
        message = (
            f"not converged after {best.rounds} rounds: parameters still move by "
            f"{best.moved:.2g} standard errors"
        )
    stray = [words for part in agreements for words in strays(part)]
    if isinstance(best.model, Posed) and in_space:
        # Whatever frame a start was followed in.
        others = [_seen_from(end, best.model) for end in ends[1:]]
        ends = [best, *others]
    starts = _starts(ends, names)
    flips = settled and best.moved > 0.05
    warnings = [
        *([f"parameters flip by {best.moved:.2g} standard errors"] if flips else []),
        *bounds.values(),
        *(f"{name} is not determined by this target" for name in names if not identifiable[name]),
        *(combinations(best, names, declared, found) if finite else []),
        *_rivals(starts, standard_errors(names, matrix), declared),
        *(w for part, seen in zip(agreements, best.seen, strict=True)
          for w in _about(part, seen.uv, bare(best.model), noise)),
        *(systematic(agreements[0], bare(best.model)) if finite else []),
    ]  # fmt: skip
    pose, freedom = Pose.identity(), float(len(names))
    pose_stderr = {}
    if isinstance(source, Posed) and in_space:
        pose = source.placement
        errors = standard_errors(names, matrix)
        pose_stderr = {
            n: errors[n] * _pose_unit(n, source) for n in Posed.similarity if n in errors
        }
        own = [k for k, name in enumerate(names) if name not in Posed.similarity]
        names, matrix = tuple(names[k] for k in own), matrix[np.ix_(own, own)]
        values = {name: x for name, x in values.items() if name not in Posed.similarity}
        identifiable = {name: identifiable[name] for name in names}
    elif isinstance(source, Posed):
        pose = source.placement
        warnings.append(
            "without a camera lengths are relative: one unit of the model is "
            f"{pose.scale:.4g} pixels"
        )
        values, matrix = _in_pixels(source, names, values, matrix)
    stderr = standard_errors(names, matrix)
    model = bare(source)
    for name in parameters(model):
        model = with_value(model, name, values[name])
    return FitResult(
        model=model,
        pose=pose,
        pose_stderr=pose_stderr,
        values=values,
        stderr=stderr,
        identifiable=identifiable,
        names=names,
        covariance=matrix,
        agreements=tuple(agreements),
        freedom=freedom,
        converged=status == "converged",
        status=status,
        message="; ".join([message, *stray, *warnings, *_symmetries(model)]),
        warnings=tuple(warnings),
        steps=best.rounds,
        starts=starts,
    )


def _seen_from(end: Settled, posed: Posed) -> Settled:
    """An end with its pose in the frame of another."""
    assert isinstance(end.model, Posed)
    return dataclasses.replace(end, model=end.model.seen_from(posed))


def _pose_unit(name: str, posed: Posed) -> float:
    """What the pose's own unit of a parameter is in the result's."""
    return 1.0 if name.startswith("turn") else float(posed.unit)


def _symmetries(model: AbstractSurface) -> list[str]:
    """What no target can tell of this surface, and no parameter says."""
    if not is_of_revolution(model):
        return []
    return ["it is a surface of revolution: no target tells how it is turned about its y axis"]


def _starts(ends: list[Settled], names: tuple[str, ...]) -> tuple[Start, ...]:
    return tuple(
        Start(
            end.label,
            {name: float(value_at(end.model, name)) for name in names},
            math.sqrt(np.average(end.seen[0].distance ** 2, weights=end.seen[0].weights)),
            end.chi2 - ends[0].chi2,
        )
        for end in ends
    )


def _rivals(
    starts: tuple[Start, ...], stderr: dict[str, float], declared: dict[str, Parameter]
) -> list[str]:
    """A warning that names the rivals, if there are any."""
    found = [f"{s.label} (Δχ² {s.delta_chi2:.1f})" for s in rivals(starts, stderr, declared)]
    return [f"almost as good: {', '.join(found)}"] if found else []


def _in_pixels(
    posed: Posed, names: tuple[str, ...], values: dict[str, float], matrix: np.ndarray
) -> tuple[dict[str, float], np.ndarray]:
    """Scale in pixels a unit, and where the model's origin is seen, instead of Posed's own units."""
    placed = posed.placement
    unit = float(posed.unit)
    factors = np.array([unit if name in Posed.in_image else 1.0 for name in names])
    right, down, _ = map(float, placed.translation)
    pixels = {"scale": float(placed.scale), "shift_x": right, "shift_y": down}
    return values | pixels, matrix * np.outer(factors, factors)


def _size(target: PointCloud | Silhouette) -> float:
    """Of a cloud the diagonal of its box, of a silhouette that of its mask's, in pixels."""
    if isinstance(target, PointCloud):
        return target.diagonal
    rows, columns = np.nonzero(target.mask >= 0.5)
    return math.hypot(np.ptp(rows), np.ptp(columns))


def _misfit(part: Agreement, strained: bool, noise: float | None, in_space: bool) -> str:
    """Why the surface does not follow a target; empty if it does."""
    size = _size(part.target)
    if isinstance(part.target, PointCloud):
        far = part.strays / len(part.weights)
        if far > _MOSTLY_STRAYS:
            return f"no petal of this model fits: it is far from {100 * far:.0f} % of the points"
    tolerable = (_STRAINED_MISFIT if strained else _MISFIT) * size
    rms = part.rms
    if isinstance(part.target, Silhouette):
        # A few places are matched across a fold, far away.
        rms = spread_of(part.distances[part.weights > 0])
        frame = "its camera is not where it is said to be, or it has another shape"
        tolerable = max(0.5 * tolerable, 1.0)
    else:
        frame = (
            "either it is not in the model's frame and unit (pose='known'), or it has another shape"
        )
        if in_space:
            frame = "it has another shape, or is in another unit"
        tolerable = max(tolerable, 1.5 * (noise or 0.0))
    if rms <= tolerable:
        return ""
    return (
        f"no petal of this model fits: distances are {100 * rms / size:.1f} % of the target's "
        f"diagonal; {frame}"
    )


def at_bounds(
    values: dict[str, float], names: tuple[str, ...], declared: dict[str, Parameter]
) -> dict[str, str]:
    """Parameters at a bound, each with its warning."""
    found = {}
    for name in names:
        low, high = declared[name].bounds
        if min(values[name] - low, high - values[name]) < 0.005 * (high - low):
            found[name] = f"{name} ended at the bound of its range ({low:g}, {high:g})"
    return found


def _about(
    part: Agreement, uv: np.ndarray | None, model: AbstractSurface, noise: float | None
) -> list[str]:
    """Warnings on one target."""
    if isinstance(part.target, Silhouette):
        return []
    found = _distance_warnings(part, part.target, noise)
    return found + (_coverage_warnings(model, uv, part.used) if uv is not None else [])


def strays(part: Agreement) -> list[str]:
    """How many points the fit takes for strays, if there are any."""
    count = part.strays
    return [f"{count} of {len(part.weights)} points are taken for strays"] if count else []


def _distance_warnings(part: Agreement, cloud: PointCloud, noise: float | None) -> list[str]:
    used = np.abs(part.distances[part.used])
    typical = spread_of(used)
    found = []
    if noise is not None and part.rms > 1.5 * noise:
        found.append(f"distances are {part.rms / noise:.1f} times the given noise")
    gross = int(np.count_nonzero(used > _GROSS * max(typical, 1e-12 * cloud.diagonal)))
    if gross:
        found.append(
            f"{gross} points lie beyond {_GROSS:g} times the typical distance: if they are strays, "
            "use loss='robust'"
        )
    return found


def systematic(part: Agreement, model: AbstractSurface) -> list[str]:
    """A warning if distances have a pattern on the surface."""
    found = part.misfit(model.domain)
    if found is None or part.rms < _ROUNDING * _size(part.target):
        return []
    return found.words()


def _coverage_warnings(model: AbstractSurface, uv: np.ndarray, members: np.ndarray) -> list[str]:
    """A part of the surface without data, seen in 4 × 4 parts of the domain."""
    (u_low, u_high), (v_low, v_high) = model.domain
    used = np.flatnonzero(members)
    # Where the surface goes on, so do foot points.
    low, high = np.array(model.domain).T
    around = low + (uv[used] - low) % (high - low)
    u, v = np.where(model.edges, uv[used], around).T
    counts, *_ = np.histogram2d(u, v, bins=4, range=[[u_low, u_high], [v_low, v_high]])
    empty = np.count_nonzero(counts == 0) / counts.size
    if empty <= _EMPTY or len(used) < 8 * counts.size:
        return []
    return [f"{100 * empty:.0f} % of the surface has no data; there it is extrapolated"]
