"""The verdict on a fit: how it ended, and every reason to doubt it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from petalfit.components import Parameter
from petalfit.fitting.inference.coverage import Coverage
from petalfit.fitting.inference.turns import alone_when_turned
from petalfit.fitting.likelihood.scales import spread_of
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import Silhouette
from petalfit.results import (
    Agreement,
    FitWarning,
    Start,
    Status,
    WarningKind,
    rivals,
)
from petalfit.surfaces import AbstractSurface, is_of_revolution

# Distances beyond this fraction of a target's size are a misfit, not noise.
_MISFIT = 0.02
# The same if determined parameters ended at their bounds.
_STRAINED_MISFIT = 0.005
_MISFIT_OF_OUTLINES = 0.01  # the same for contours of masks
# Parts of the outline without points near it, from which the surface has another shape if that is said by
# other signs too; if it happens in several places; and in any case.
_BARE, _SCATTERED, _MOSTLY_BARE = 0.15, 0.08, 0.6
_WIDELY_BARE = 0.25  # the same if distances have a pattern, as they have on every real petal
# The first in a fitted pose, where an L may seem to be half of a petal; half of a true one has 0.48.
_BARE_ANYWHERE = 0.52
_ELSEWHERE = 0.18  # the same if points go on beyond a tenth of the outline elsewhere
# The same if so much of the rest of it runs beside the points; of parts of true petals, at most 0.15
# unless there are 100 points or fewer.
_BESIDE = 0.17
# Parts of the outline where points go on beyond it, from which it has another shape if many points lie
# beyond the whole surface too; and in any case.
_CROSSED, _MOSTLY_CROSSED = 0.1, 0.2
_HOLE = 0.35  # part of the surface in holes, from which the points are a ring
# Part of a surface that can follow points anywhere, from which they are no single sheet: that of scanned
# leaves is 0.008 folded by stray points, that of two crossed ones 0.01 to 0.02.
_FOLDED = 0.009
# Depth of a bay of the outline, relative to the length, from which it is no petal's: those of scanned
# petals are 0.05 deep, that of a water lily's leaf 0.12.
_BAY = 0.1
# Part of the points that have none beside them after a turn, up to which the turned ones are the same.
_SAME = 0.05
# The other signs: part of the points that lie beyond this distance, and size of a pattern of distances,
# both distances relative to the target's size.
_SOME_BEYOND, _MANY_BEYOND, _BEYOND, _PATTERN = 0.01, 0.025, 0.01, 0.004
_GROSS = 6.0  # in units of the noise
_EMPTY = 0.1  # part of the surface without data, above which there is a warning
_ROUNDING = 1e-6  # smaller distances, relative to a target's size, are rounding errors
_MOSTLY_OUTLIERS = 0.6  # part of the points that may be outliers; above it nothing was fitted
# A fit counts as converged if its parameters still move by at most SETTLED standard errors, with a
# warning if it is more than _FLIPS: points that jump between two folds may keep a fit moving for ever.
SETTLED, _FLIPS = 0.5, 0.2
# Parameters that still move by less than this leave an outline nearly where it is.
NEARLY_SETTLED = 3.0


def ending(best: Iterate, finite: bool, misfits: Sequence[str], outcome: str) -> tuple[Status, str]:
    """The status of a fit, and the reason for it in words.

    Args:
        best: The best end.
        finite: Whether all of its numbers are finite.
        misfits: For every target, the reason why the surface does not follow it; "" if it does.
        outcome: The reason of a fit that converged.
    """
    if not finite:
        return Status.NOT_FINITE, "the solver met values that are not finite"
    if any(misfits):
        return Status.MISFIT, next(filter(None, misfits))
    if best.moved <= SETTLED:
        return Status.CONVERGED, outcome
    return Status.ROUND_LIMIT, (
        f"not converged after {best.rounds} rounds: parameters still move by "
        f"{best.moved:.2g} standard errors"
    )


def misfit_of(
    part: Agreement,
    strained: bool,
    noise: float | None,
    in_space: bool,
    left_out: float | None = None,
    hides: bool = False,
) -> str:
    """The reason why the surface does not follow a target; "" if it does.

    Args:
        part: The target with its distances from the surface.
        strained: Whether determined parameters ended at their bounds.
        noise: The noise that was given for the clouds.
        in_space: Whether a pose in space was fitted.
        left_out: The part of the points that seemed to lie on a surface, but are taken for outliers; of
            all points if it is None. Clutter may be the greater part of a cloud, but lies on no surface.
        hides: Whether the surface was taken to be flat, because one outline hides how it is bent.
    """
    size = part.target.size
    far, points = part.outliers / len(part.weights), "points"
    if left_out is not None:
        far, points = min(left_out, far), "points that seem to lie on a surface"
    if far > _MOSTLY_OUTLIERS:
        return f"no petal of this model fits: it is far from {100 * far:.0f} % of the {points}"
    if part.unit == "px":
        rms, tolerable = _trimmed(part), max(_MISFIT_OF_OUTLINES * size, 1.0)
        why = "it has another shape"
        if isinstance(part.target, Silhouette) and part.target.camera is not None:
            why = "its camera is not where it is said to be, or it has another shape"
        if hides:
            why = f"it is bent (add masks from other directions, which show that), {why}"
    else:
        rms, tolerable = part.rms, (_STRAINED_MISFIT if strained else _MISFIT) * size
        tolerable = max(tolerable, 1.5 * (noise or 0.0))
        why = "it has another shape, or is in another unit"
        if not in_space:
            why = "it is not in the model's frame and unit (pose='known'), or has another shape"
    if rms <= tolerable:
        return ""
    return (
        f"no petal of this model fits: distances are {100 * rms / size:.1f} % of the target's "
        f"diagonal; {why}"
    )


def misfit_of_outline(
    part: Agreement, seen: Coverage, systematic: float, is_free: bool, in_space: bool
) -> str:
    """The reason why the surface has another outline than a cloud; "" if it may have the same.

    A part of a petal may be hidden or cut off. Then the outline has no points along one stretch, and
    everywhere else the petal fits.

    Args:
        part: The cloud with its distances from the surface.
        seen: The parts of the surface that have no points near them.
        systematic: Root mean square of the systematic part of the distances.
        is_free: Whether the surface can follow any sheet.
        in_space: Whether the pose was fitted.
    """
    size = part.target.size
    bare = f"{100 * seen.outline:.0f} % of its outline has no points near it"
    empty = f"no petal of this model fits: {bare}"
    if seen.hole > _HOLE:
        return (
            f"no petal of this model fits: {100 * seen.hole:.0f} % of it are a hole without points; "
            "they are a ring, or lie around a closed body"
        )
    if is_free and seen.folded > _FOLDED:
        return (
            "no petal of this model fits: the surface has to fold back on itself to follow the points; "
            "they are no single sheet"
        )
    if seen.outline > (_BARE_ANYWHERE if in_space else _MOSTLY_BARE):
        return f"{empty}; the points have another shape"
    if seen.scattered > _SCATTERED:
        return f"{empty}, in several places; the points have another outline"
    used = np.abs(part.distances[part.used])
    beyond = float(np.mean(used > max(_GROSS * spread_of(used), _BEYOND * size)))
    if seen.crossed > (_CROSSED if beyond > _MANY_BEYOND else _MOSTLY_CROSSED):
        return (
            f"no petal of this model fits: the points go on beyond {100 * seen.crossed:.0f} % of its "
            "outline; they have another outline, or none"
        )
    if seen.outline > _ELSEWHERE and seen.crossed > _CROSSED:
        return (
            f"{empty}, and the points go on beyond {100 * seen.crossed:.0f} % of it; they have another "
            "outline"
        )
    beside = seen.loose - seen.outline
    if seen.outline > _WIDELY_BARE and beside > _BESIDE:
        return f"{empty}, and {100 * beside:.0f} % more runs beside the points; they have another outline"
    if seen.outline > _BARE and beyond > _SOME_BEYOND:
        return f"{empty}, while {100 * beyond:.1f} % of the points lie beyond it"
    if seen.outline > _WIDELY_BARE and systematic > _PATTERN * size:
        return f"{empty}, and its distances from the points have a pattern; they have another shape"
    return ""


def misfit_of_bays(seen: Coverage) -> str:
    """The reason why a surface that follows the points is no petal, if it has a deep bay; else ""."""
    if seen.bay <= _BAY:
        return ""
    return (
        "no petal of this model fits: to follow the points, its outline has a bay that goes in by "
        f"{100 * seen.bay:.0f} % of its length; they are of several petals, of a part of one, or of "
        "another shape"
    )


def misfit_of_turns(points: Float[np.ndarray, "n 3"]) -> str:
    """The reason why points are no petal's, if they are the same when they are turned; else "".

    Args:
        points: The points that belong to the surface.
    """
    if alone_when_turned(points) > _SAME:
        return ""
    return (
        "no petal of this model fits: the points are the same after a third, a quarter or a fifth of a "
        "turn, so that nothing tells base and tip from the sides"
    )


def _trimmed(part: Agreement) -> float:
    """The root mean square distance without a twentieth: a few places are matched across a fold."""
    distance = np.sort(np.abs(part.distances[part.weights > 0]))
    kept = distance[: len(distance) - len(distance) // 20]
    return float(np.sqrt(np.mean(kept**2))) if len(kept) else np.inf


def about_targets(parts: Sequence[Agreement]) -> list[FitWarning]:
    """What was noted about each target when it was read."""
    return [FitWarning(note, WarningKind.TARGET) for part in parts for note in part.target.notes]


def at_bounds(
    values: Mapping[str, float], names: Sequence[str], declared: Mapping[str, Parameter]
) -> list[FitWarning]:
    """A warning for each parameter that ended at a bound."""
    found = []
    for name in names:
        low, high = declared[name].bounds
        if min(values[name] - low, high - values[name]) < 0.005 * (high - low):
            text = f"{name} ended at the bound of its range ({low:g}, {high:g})"
            found.append(FitWarning(text, WarningKind.AT_BOUND, [name]))
    return found


def not_determined(identifiable: Mapping[str, bool], what: str = "target") -> list[FitWarning]:
    """A warning for each parameter that the data do not determine."""
    return [
        FitWarning(f"{name} is not determined by this {what}", WarningKind.NOT_DETERMINED, [name])
        for name, known in identifiable.items()
        if not known
    ]


def flips(best: Iterate) -> list[FitWarning]:
    """A warning if the parameters of a fit that counts as converged still move a little."""
    if not _FLIPS < best.moved <= SETTLED:
        return []
    return [
        FitWarning(f"parameters still move by {best.moved:.2g} standard errors", WarningKind.FLIPS)
    ]


def rival_starts(
    starts: tuple[Start, ...],
    stderr: Mapping[str, float],
    declared: Mapping[str, Parameter],
    inflation: float = 1.0,
) -> list[FitWarning]:
    """A warning that names the rivals, if there are any; see `rivals` for the inflation."""
    close = rivals(starts, stderr, declared, inflation)
    found = [f"{s.label} (Δχ² {s.delta_chi2 / inflation:.1f})" for s in close]
    text = f"almost as good: {', '.join(found)}"
    return [FitWarning(text, WarningKind.RIVALS)] if found else []


def outliers(part: Agreement) -> list[str]:
    """A note that gives the number of outliers, if there are any."""
    count = part.outliers
    return [f"{count} of {len(part.weights)} points are taken for outliers"] if count else []


def symmetries(model: AbstractSurface) -> list[str]:
    """A note on a symmetry of the surface, under which no target determines how it is turned."""
    if not is_of_revolution(model):
        return []
    return ["it is a surface of revolution: no target tells how it is turned about its y axis"]


def about_distances(part: Agreement, noise: float | None) -> list[FitWarning]:
    """Warnings about the distances of one target, if they are in the unit of length."""
    if part.unit != "length":
        return []
    used = np.abs(part.distances[part.used])
    typical = spread_of(used) if len(used) else np.inf
    found = []
    if noise is not None and part.rms > 1.5 * noise:
        text = f"distances are {part.rms / noise:.1f} times the given noise"
        found.append(FitWarning(text, WarningKind.NOISE))
    gross = int(np.count_nonzero(used > _GROSS * max(typical, 1e-12 * part.target.size)))
    if gross:
        text = (
            f"{gross} points lie beyond {_GROSS:g} times the typical distance: if they are outliers, "
            "use loss='robust'"
        )
        found.append(FitWarning(text, WarningKind.OUTLIERS))
    return found


def systematic(part: Agreement, model: AbstractSurface) -> list[FitWarning]:
    """A warning if distances have a pattern on the surface."""
    found = part.misfit(model.domain)
    if found is None or part.rms < _ROUNDING * part.target.size:
        return []
    return found.warnings()


def systematic_rms(part: Agreement, model: AbstractSurface) -> float:
    """Root mean square of the part of a cloud's distances that has a pattern on the surface."""
    found = part.misfit(model.domain)
    return 0.0 if found is None else part.rms * float(np.sqrt(found.systematic))


def about_coverage(seen: Coverage | None) -> list[FitWarning]:
    """A warning if a part of the surface has no points near it."""
    if seen is None or seen.area <= _EMPTY:
        return []
    text = f"{100 * seen.area:.0f} % of the surface has no data near it"
    if seen.outline <= _BARE:
        text = f"{text}; there it is extrapolated"
    else:
        text = (
            f"{text}, nor has {100 * seen.outline:.0f} % of its outline: if no part of the petal was "
            "hidden or cut off, it has another shape"
        )
    return [FitWarning(text, WarningKind.COVERAGE)]
