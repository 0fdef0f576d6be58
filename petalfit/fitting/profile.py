"""Profile likelihoods: how much worse a model explains its targets with one parameter held elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from petalfit.components import bare, parameters
from petalfit.fitting.coordinates import with_values
from petalfit.fitting.families.registry import family_of
from petalfit.fitting.likelihood.matching import CORRELATED
from petalfit.fitting.request.request import Request
from petalfit.fitting.run import run
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import reporting_to
from petalfit.fitting.solver.threads import one_thread
from petalfit.observations import TargetError
from petalfit.results import FitRecord, Profile
from petalfit.surfaces import with_value

_REACH = 5.0  # standard errors to either side
_NEAR = 12.0  # χ² above the minimum up to which a parabola is fitted
_TRIMMED = 0.05  # part of a contour, the farthest places, that is left out
_INSIDE = 1e-6  # margin inside the bounds, relative to their distance


def profile_of(
    result: FitRecord, name: str, points: int, progress: Callable[[str], None] | None
) -> Profile:
    """The profile likelihood of a parameter; see `FitResult.with_profile`."""
    own = parameters(result.model)
    if name not in result.names or name not in own:
        raise TargetError(
            f"{name!r} was not fitted; profiles can be had of "
            f"{', '.join(n for n in result.names if n in own)}."
        )
    if result.pose_stderr:
        raise TargetError("profiles are there for targets of a known pose.")
    if points < 5:
        raise ValueError(f"a profile needs at least 5 points; received {points}")
    tell = progress or (lambda text: None)
    low, high = _range(result, name)
    values = np.linspace(low, high, points)
    # Waves that are not determined are left out: they would follow the noise, differently at every value.
    waves, start = result.model.oscillation, result.model
    hidden = (
        []
        if waves is None
        else [
            n for n in waves.names if n in result.names and n != name and not result.identifiable[n]
        ]
    )
    if waves is not None and waves.amplitude in hidden:
        start = with_values(start, {waves.amplitude: 0.0})
    rest = tuple(n for n in result.names if n in own and n != name and n not in hidden)
    if not rest:
        raise TargetError(f"{name} is the only free parameter; its interval says all there is.")
    found = np.full(points, np.inf)
    # The values are taken outwards from the fitted one, and back. Each fit so starts at the ends of both
    # neighbours, and the better one counts.
    middle = int(np.argmin(np.abs(values - result.values[name])))
    with one_thread(), reporting_to(None):
        for side in (range(middle, points), range(middle - 1, -1, -1)):
            model = start
            for k in (*side, *side[-2::-1]):
                tell(f"profile of {name}: {values[k]:.4g}")
                model = with_value(model, name, float(values[k]))
                request = Request(
                    template=model,
                    free=rest,
                    targets=tuple(part.target.counting(part.weights) for part in result.agreements),
                    from_template=True,
                    begun=result.pose if result.in_image else None,
                    ends_only=True,
                )
                _, ends = run(family_of(model), request)
                model, found[k] = bare(ends[0].model), min(found[k], _cost(ends[0]))
    cost = found - np.min(found)
    values, cost = _adjusted(result, name, values, cost)
    return Profile(tuple(values.tolist()), tuple(cost.tolist()))


def _adjusted(
    result: FitRecord, name: str, values: np.ndarray, cost: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Adjusts the minimum and the curvature of a profile to the fit and its covariance.

    Distances of a contour are correlated, so that their sum of squares is no χ², and pixels shift its
    minimum; the fitted value has this bias removed (Chandler and Bate, 2007,
    doi:10.1093/biomet/asm015). Pixels make it uneven too, so that near the minimum the smooth curve
    through it counts.
    """
    error = result.stderr[name]
    if not np.isfinite(error) or all(part.unit == "length" for part in result.agreements):
        return values, cost
    near = cost <= max(_NEAR, np.sort(cost)[4])
    away = values - result.values[name]
    found = _smooth(away[near], cost[near])
    if found is None:
        return values, cost
    curve, bottom = found
    curvature = 0.5 * float(curve.deriv(2)(bottom))
    cost = np.where(near, curve(away) - curve(bottom), cost - curve(bottom))
    return values - bottom, np.maximum(cost, 0.0) / (curvature * error**2)


def _smooth(x: np.ndarray, cost: np.ndarray) -> tuple[np.polynomial.Polynomial, float] | None:
    """The smooth curve through a profile near its minimum, and the place of that; None if it has none.

    It is of the third degree, or of the second if that one has no minimum or turns down at one side.
    """
    low, high = float(x.min()), float(x.max())
    for degree in (3, 2):
        if len(x) < 2 * degree - 1:
            continue
        curve = np.polynomial.Polynomial.fit(x, cost, degree).convert()
        turns = [float(t.real) for t in curve.deriv().roots() if abs(t.imag) < 1e-12]
        bottoms = [t for t in turns if curve.deriv(2)(t) > 0 and low - x.std() < t < high + x.std()]
        tops = [t for t in turns if t not in bottoms and low < t < high]
        if bottoms and not tops:
            return curve, bottoms[0]
    return None


def _cost(end: Iterate) -> float:
    """The χ² of an end, for contours without their farthest places.

    These jump from one part of the outline to another, and would make the profile uneven.
    """
    total = 0.0
    for seen in end.residuals:
        if seen.unit == "length":
            total += seen.chi2
            continue
        squares, weights = seen.distance**2, seen.weights
        kept = squares <= np.quantile(squares[weights > 0], 1 - _TRIMMED)
        mean = np.average(squares[kept], weights=weights[kept])
        total += float(np.sum(seen.weights) / CORRELATED * np.log(mean))
    return total


def _range(result: FitRecord, name: str) -> tuple[float, float]:
    """The range of a profile: `_REACH` standard errors, or the typical range if these are infinite."""
    declared = parameters(result.model)[name]
    value, reach = result.values[name], _REACH * result.stderr[name]
    low, high = (value - reach, value + reach) if np.isfinite(reach) else declared.typical
    bottom, top = declared.bounds
    margin = _INSIDE * (top - bottom)
    return max(low, bottom + margin), min(high, top - margin)
