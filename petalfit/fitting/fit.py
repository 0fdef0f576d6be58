"""The public entry: a target and a model in, a `FitResult` out."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable

import jax
import numpy as np

from petalfit.components import Parameter, PeonyPetal, parameters
from petalfit.fitting.cloud import Settled, fit_cloud
from petalfit.fitting.result import FitError, FitResult, Pose, Start
from petalfit.observations import PointCloud, TargetError, as_point_cloud
from petalfit.surfaces import AbstractSurface

# A parameter is determined if its standard error is below this many standard deviations of its
# typical range, taken as uniform.
_DETERMINED = 0.3
# Distances of more than this fraction of the cloud's diagonal are no noise.
_MISFIT = 0.02
# And of less, if the model had to be bent to the bounds of its parameters.
_STRAINED_MISFIT = 0.005
_GROSS = 6.0  # in units of the noise
# By chance alone, the best of the some 200 frequencies that ribs could have leads by 2 log 200 in χ².
_CLEAR_LEAD = 20.0
_EMPTY = 0.1
# Where foot points jump between two folds, a fit may flip for ever between two states that are nearly
# the same: up to this many standard errors apart, that is a warning and no failure.
_SETTLED = 0.5


def fit_petal(
    target: object,
    *,
    model: type[AbstractSurface] | AbstractSurface = PeonyPetal,
    **options: object,
) -> FitResult:
    """Recover the parameters of a petal from a target: `fit` with a petal as the default model."""
    return fit(model, target, **options)  # pyright: ignore[reportArgumentType]


def fit(
    model: type[AbstractSurface] | AbstractSurface,
    target: object,
    *,
    pose: str = "known",
    free: Iterable[str] | None = None,
    init: AbstractSurface | None = None,
    noise: float | None = None,
    loss: str = "linear",
    seed: int = 0,
    throw: bool = True,
    progress: Callable[[str], None] | None = None,
) -> FitResult:
    """Recover the parameters of a component from a point cloud.

    Args:
        model: A component; of an instance, parameters that are not free keep their values.
        target: An (N, 3) array, a `PointCloud`, a trimesh mesh or cloud, or the path of a file.
        pose: "known": the target is in the model's frame and unit.
        free: Names of the parameters to fit; by default all that the model does not declare fixed.
        init: An instance to start from. Without it the fit finds its own start.
        noise: Standard deviation σ of the target's noise, in its unit; estimated if None.
        loss: "linear": least squares, right for noise without gross outliers.
        seed: Of the choice of points for the start; the result hardly depends on it.
        throw: Raise `FitError` if the solver fails; else return a result with `converged` False.
        progress: Called with a line of text whenever a stage of the fit begins.

    Returns:
        The result. Read its `warnings`.

    Raises:
        TargetError: The target cannot be used, or the options do not fit the model.
        FitError: The solver failed, and `throw` is True.
    """
    cloud = as_point_cloud(target)
    template, names = _configuration(model, free, init)
    _check_options(pose, loss, noise)
    weights = np.ones(len(cloud)) if cloud.weights is None else cloud.weights
    _check_size(cloud, weights, names, template)
    with jax.enable_x64(True):
        ends = fit_cloud(
            template,
            names,
            cloud.points,
            weights,
            noise=noise,
            from_template=init is not None,
            seed=seed,
            progress=progress or (lambda text: None),
        )
    result = _result(template, names, cloud, weights, noise, ends)
    if throw and not result.converged:
        raise FitError(result.message, result)
    return result


def _configuration(
    model: type[AbstractSurface] | AbstractSurface,
    free: Iterable[str] | None,
    init: AbstractSurface | None,
) -> tuple[PeonyPetal, tuple[str, ...]]:
    """The template and the names of its free parameters, checked."""
    kind = model if inspect.isclass(model) else type(model)
    if kind is not PeonyPetal:
        raise TypeError(f"model must be PeonyPetal, a class or an instance; received {model!r}")
    declared = parameters(kind)
    if init is not None and type(init) is not kind:
        raise TargetError(f"init must be a {kind.__name__}; received a {type(init).__name__}.")
    template = init if init is not None else PeonyPetal() if inspect.isclass(model) else model
    if free is None:
        names = tuple(name for name, p in declared.items() if not p.fixed)
    else:
        wanted = [free] if isinstance(free, str) else list(free)
        unknown = [name for name in wanted if name not in declared]
        if unknown or not wanted:
            raise TargetError(
                f"free names {', '.join(map(repr, unknown)) or 'no parameter'}; the parameters of "
                f"{kind.__name__} are {', '.join(declared)}."
            )
        names = tuple(name for name in declared if name in wanted)
    for name, parameter in declared.items():
        value = float(getattr(template, name))
        low, high = parameter.bounds
        if not low < value < high:
            raise TargetError(
                f"{name} = {value:g} of the start lies outside its range ({low:g}, {high:g}); give "
                "an init inside it."
            )
    assert isinstance(template, PeonyPetal)
    return template, names


def _check_options(pose: str, loss: str, noise: float | None) -> None:
    if pose != "known":
        raise ValueError(f"pose must be 'known'; received {pose!r}")
    if loss != "linear":
        raise ValueError(f"loss must be 'linear'; received {loss!r}")
    if noise is not None and not (math.isfinite(noise) and noise > 0):
        raise ValueError(f"noise must be a positive length or None; received {noise}")


def _check_size(
    cloud: PointCloud, weights: np.ndarray, names: tuple[str, ...], template: PeonyPetal
) -> None:
    """Enough points, in a unit in which the model's ranges can reach them."""
    count = np.count_nonzero(weights)
    if count < len(names) + 1:
        raise TargetError(
            f"{count} points cannot determine {len(names)} free parameters; at least "
            f"{len(names) + 1} are needed: give more points, or name fewer parameters in free."
        )
    lengths = [p.bounds for p in parameters(template).values() if p.unit == "length"]
    largest = max(high for _, high in lengths)
    smallest = min(low for low, _ in lengths if low > 0)
    reach = float(np.abs(cloud.points).max())
    kind = type(template).__name__
    if reach > 10 * largest:
        raise TargetError(
            f"coordinates reach {reach:.3g} where the lengths of {kind} end at {largest:g}: bring the "
            "target to the model's unit and near its origin."
        )
    if cloud.diagonal < 0.1 * smallest:
        raise TargetError(
            f"the target is only {cloud.diagonal:.3g} across where the lengths of {kind} begin at "
            f"{smallest:g}: bring it to the model's unit."
        )


def _result(
    template: PeonyPetal,
    names: tuple[str, ...],
    cloud: PointCloud,
    weights: np.ndarray,
    noise: float | None,
    ends: list[Settled],
) -> FitResult:
    best = ends[0]
    n = len(cloud)
    beyond = np.maximum(best.beyond[:n], 0.0)
    distances = np.where(
        beyond > 0,
        np.copysign(np.hypot(best.distance[:n], beyond), best.distance[:n]),
        best.distance[:n],
    )
    declared = parameters(template)
    finite = bool(
        np.isfinite([*vars(best.model).values()]).all()
        and np.isfinite(best.information).all()
        and np.isfinite(distances).all()
    )
    settled = finite and bool(best.moved <= _SETTLED)
    rms = math.sqrt(np.average(distances**2, weights=weights)) if finite else math.inf
    covariance, identifiable = _covariance(ends, names, declared, finite)
    values = {
        name: float(getattr(best.model, name)) if finite else float(getattr(template, name))
        for name in declared
    }
    bounds = _at_bounds(values, names, declared)
    strained = any(identifiable[name] for name in bounds)
    tolerable = (_STRAINED_MISFIT if strained else _MISFIT) * cloud.diagonal
    misfit = rms > max(tolerable, 1.5 * (noise or 0.0))
    status = (
        "not_finite"
        if not finite
        else "misfit"
        if misfit
        else "converged"
        if settled
        else "round_limit"
    )
    sigma = best.sigma
    stderr = dict(zip(names, map(float, np.sqrt(np.diag(covariance))), strict=True))
    flips = settled and best.moved > 0.05
    warnings = [
        *([f"parameters flip by {best.moved:.2g} standard errors"] if flips else []),
        *bounds.values(),
        *(f"{name} is not determined by this target" for name in names if not identifiable[name]),
        *_distance_warnings(cloud, distances, weights, rms, noise),
        *_coverage_warnings(best, weights),
    ]
    message = {
        "converged": f"converged after {best.rounds} rounds",
        "round_limit": f"not converged after {best.rounds} rounds: parameters still move "
        f"by {best.moved:.2g} standard errors",
        "misfit": f"no petal of this model fits: distances are {100 * rms / cloud.diagonal:.1f} % of the "
        "target's diagonal; either it is not in the model's frame and unit (pose='known'), or it has "
        "another shape",
        "not_finite": "the solver met values that are not finite",
    }[status]
    return FitResult(
        model=type(template)(**values),
        pose=Pose.identity(),
        values=values,
        stderr=stderr,
        identifiable=identifiable,
        names=names,
        covariance=covariance,
        noise=sigma,
        rms=rms,
        distances=distances,
        weights=np.array(weights, float),
        converged=status == "converged",
        status=status,
        message="; ".join([message, *warnings]),
        warnings=tuple(warnings),
        steps=best.rounds,
        starts=tuple(
            Start(
                end.label,
                {name: float(getattr(end.model, name)) for name in names},
                math.exp(0.5 * end.chi2 / weights.sum()),
                end.chi2 - best.chi2,
            )
            for end in ends
        ),
        target=cloud,
    )


def _covariance(
    ends: list[Settled], names: tuple[str, ...], declared: dict[str, Parameter], finite: bool
) -> tuple[np.ndarray, dict[str, bool]]:
    """Inverse information; what is not determined gets infinite rows and columns.

    The standard errors of the determined parameters are those with the others left free.
    """
    spread = np.array([np.ptp(declared[name].typical) for name in names]) / math.sqrt(12)
    if not finite:
        return np.full((len(names), len(names)), np.inf), dict.fromkeys(names, False)
    scaled = ends[0].information * np.outer(spread, spread)
    # Directions of no information at all keep a variance of 1e16 instead of a division by zero.
    eigenvalues, vectors = np.linalg.eigh(scaled)
    relative = (vectors / np.maximum(eigenvalues, 1e-16)) @ vectors.T
    known = np.sqrt(np.diag(relative)) < _DETERMINED
    for name in _doubtful_ribs(names, known, ends):
        known[names.index(name)] = False
    covariance = np.where(np.outer(known, known), relative * np.outer(spread, spread), np.inf)
    return covariance, dict(zip(names, map(bool, known), strict=True))


def _doubtful_ribs(names: tuple[str, ...], known: np.ndarray, ends: list[Settled]) -> list[str]:
    """Rib parameters that the local information is too sure of.

    Ribs that are not there have no frequency, whatever the curvature of the cost says; and where
    another frequency fits almost as well, neither is known, nor how high the ribs are.
    """
    ribs = [name for name in ("rib_frequency", "rib_amplitude") if name in names]
    if "rib_frequency" not in ribs:
        return []
    best = float(ends[0].model.rib_frequency)
    rivals = [
        end
        for end in ends[1:]
        if abs(float(end.model.rib_frequency) - best) > 0.5
        and end.chi2 - ends[0].chi2 < _CLEAR_LEAD
    ]
    if rivals:
        return ribs
    return ["rib_frequency"] if not known[names.index(ribs[-1])] else []


def _at_bounds(
    values: dict[str, float], names: tuple[str, ...], declared: dict[str, Parameter]
) -> dict[str, str]:
    """Parameters at a bound, each with its warning."""
    found = {}
    for name in names:
        low, high = declared[name].bounds
        if min(values[name] - low, high - values[name]) < 0.005 * (high - low):
            found[name] = f"{name} ended at the bound of its range ({low:g}, {high:g})"
    return found


def _distance_warnings(
    cloud: PointCloud,
    distances: np.ndarray,
    weights: np.ndarray,
    rms: float,
    noise: float | None,
) -> list[str]:
    used = np.abs(distances[weights > 0])
    typical = 1.4826 * float(np.median(used))
    found = []
    if noise is not None and rms > 1.5 * noise:
        found.append(f"distances are {rms / noise:.1f} times the given noise")
    gross = int(np.count_nonzero(used > _GROSS * max(typical, 1e-12 * cloud.diagonal)))
    if gross:
        found.append(
            f"{gross} points lie beyond {_GROSS:g} times the typical distance; remove strays, or give "
            "them weight 0"
        )
    return found


def _coverage_warnings(best: Settled, weights: np.ndarray) -> list[str]:
    """A part of the surface without data, seen in 4 × 4 parts of the domain."""
    (u_low, u_high), (v_low, v_high) = best.model.domain
    used = np.flatnonzero(weights > 0)
    u, v = best.uv[used].T
    counts, *_ = np.histogram2d(u, v, bins=4, range=[[u_low, u_high], [v_low, v_high]])
    empty = np.count_nonzero(counts == 0) / counts.size
    if empty <= _EMPTY or len(used) < 8 * counts.size:
        return []
    return [f"{100 * empty:.0f} % of the surface has no data; there it is extrapolated"]
