"""The verdict on a fit: how it ended, and every reason to doubt it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from petalfit.components import Parameter
from petalfit.fitting.likelihood.scales import spread_of
from petalfit.fitting.solver.iterate import Iterate
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
_GROSS = 6.0  # in units of the noise
_EMPTY = 0.1  # part of the surface without data, above which there is a warning
_ROUNDING = 1e-6  # smaller distances, relative to a target's size, are rounding errors
_MOSTLY_OUTLIERS = 0.6  # part of the points that are outliers, above which nothing was fitted
# A fit counts as converged if its parameters still move by at most _SETTLED standard errors, with a
# warning if it is more than _FLIPS: points that jump between two folds may keep a fit moving for ever.
_SETTLED, _FLIPS = 0.5, 0.2


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
    if best.moved <= _SETTLED:
        return Status.CONVERGED, outcome
    return Status.ROUND_LIMIT, (
        f"not converged after {best.rounds} rounds: parameters still move by "
        f"{best.moved:.2g} standard errors"
    )


def misfit_of(part: Agreement, strained: bool, noise: float | None, in_space: bool) -> str:
    """The reason why the surface does not follow a target; "" if it does.

    Args:
        part: The target with its distances from the surface.
        strained: Whether determined parameters ended at their bounds.
        noise: The noise that was given for the clouds.
        in_space: Whether a pose in space was fitted.
    """
    size = part.target.size
    far = part.outliers / len(part.weights)
    if far > _MOSTLY_OUTLIERS:
        return f"no petal of this model fits: it is far from {100 * far:.0f} % of the points"
    tolerable = (_STRAINED_MISFIT if strained else _MISFIT) * size
    rms = part.rms
    if part.unit == "px":
        # A robust measure, because a few places are matched across a fold, far away.
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
    if not _FLIPS < best.moved <= _SETTLED:
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


def coverage(
    model: AbstractSurface, uv: Float[np.ndarray, "n 2"], used: np.ndarray
) -> list[FitWarning]:
    """A warning if some of 4 × 4 parts of the domain have no data."""
    (u_low, u_high), (v_low, v_high) = model.domain
    some = np.flatnonzero(used)
    # In a direction without edges the surface is closed, and foot points are taken modulo the period.
    low, high = np.array(model.domain).T
    around = low + (uv[some] - low) % (high - low)
    u, v = np.where(model.edges, uv[some], around).T
    counts, *_ = np.histogram2d(u, v, bins=4, range=[[u_low, u_high], [v_low, v_high]])
    empty = np.count_nonzero(counts == 0) / counts.size
    if empty <= _EMPTY or len(some) < 8 * counts.size:
        return []
    text = f"{100 * empty:.0f} % of the surface has no data; there it is extrapolated"
    return [FitWarning(text, WarningKind.COVERAGE)]
