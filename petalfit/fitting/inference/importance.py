"""Draws from the posterior: those of its Gaussian approximation, weighted by the likelihood."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.components import Posed, parameters
from petalfit.fitting.inference.linear_rows import Linear
from petalfit.observations import PointCloud
from petalfit.residuals import frame, newton
from petalfit.results import Draws, FitRecord
from petalfit.surfaces import AbstractSurface, batch_of, in_doubles, value_at

_POINTS = 192  # so many points tell how far the likelihood is from Gaussian
_ROUNDS = 50  # attempts to draw inside the bounds


def draws_of(result: FitRecord, n: int, seed: int) -> Draws:
    """Draws of the parameters of a fit; see `FitResult.draws`."""
    posterior = result.posterior
    assert posterior is not None
    names, rng = posterior.names, np.random.default_rng(seed)
    model = _posed(result, names)
    centre = np.array([float(value_at(model, name)) for name in names])
    found = _inside(model, names, centre, posterior.covariance, n, rng)
    k_hat = float("nan")
    if result.discrepancy is None and _is_one_cloud(result):
        with jax.enable_x64(True):
            ratios = _log_ratios(result, model, names, found, centre)
        weights, k_hat = smoothed(ratios)
        found = found[rng.choice(n, n, p=weights)]
    own = [k for k, name in enumerate(names) if name in parameters(result.model)]
    kept, values = [names[k] for k in own], found[:, own]
    scale = float(result.pose.scale)
    if "scale" in names and "scale" not in kept:
        values = np.column_stack([values, scale * found[:, names.index("scale")]])
        kept.append("scale")
    return Draws(tuple(kept), values, k_hat, result.model, scale)


def smoothed(log_ratios: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], float]:
    """Normalised importance weights with a smoothed tail, and its shape k̂.

    The largest ratios are replaced by the quantiles of the generalised Pareto distribution that fits
    them (Vehtari, Simpson, Gelman, Yao and Gabry 2024; the fit is that of Zhang and Stephens 2009).
    """
    n = len(log_ratios)
    weights = np.exp(log_ratios - np.max(log_ratios))
    tail = int(min(0.2 * n, 3 * np.sqrt(n)))
    if tail < 5:
        return weights / weights.sum(), float("nan")
    order = np.argsort(weights)
    largest = order[-tail:]
    cutoff = weights[order[-tail - 1]]
    excess = weights[largest] - cutoff
    k_hat = -np.inf
    if excess[-1] > 1e-12 * weights[largest[-1]]:
        k_hat, size = _pareto(np.maximum(excess, 1e-300))
        place = (np.arange(tail) + 0.5) / tail
        quantiles = (
            -np.log1p(-place) if abs(k_hat) < 1e-8 else np.expm1(-k_hat * np.log1p(-place)) / k_hat
        )
        weights[largest] = np.minimum(cutoff + size * quantiles, 1.0)
    return weights / weights.sum(), float(k_hat)


def _pareto(excess: Float[np.ndarray, " m"]) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto distribution, for exceedances in ascending order."""
    m = len(excess)
    count = 30 + int(np.sqrt(m))
    quartile = excess[int(m / 4 + 0.5) - 1]
    theta = 1 / excess[-1] + (1 - np.sqrt(count / (np.arange(count) + 0.5))) / (3 * quartile)
    shapes = np.mean(np.log1p(-theta[:, None] * excess), axis=1)
    profile = m * (np.log(-theta / shapes) - shapes - 1)
    share = 1 / np.sum(np.exp(profile - profile[:, None]), axis=1)
    best = float(np.sum(theta * share) / np.sum(share))
    shape = float(np.mean(np.log1p(-best * excess)))
    # A weak prior draws the shape of a short tail towards ½.
    return (m * shape + 5) / (m + 10), -shape / best


def _posed(result: FitRecord, names: Sequence[str]) -> AbstractSurface:
    """The model in the pose of the target, as the parameters of the posterior describe it."""
    model = in_doubles(result.model)
    if not set(names) - set(parameters(result.model)):
        return model
    pose = result.pose
    return Posed(model, pose.rotation, pose.translation, np.float64(pose.scale))


def _is_one_cloud(result: FitRecord) -> bool:
    part = result.agreements[0]
    one = len(result.agreements) == 1 and isinstance(part.target, PointCloud)
    return one and part.uv is not None and part.noise > 0


def _inside(
    model: AbstractSurface,
    names: Sequence[str],
    centre: Float[np.ndarray, " q"],
    covariance: Float[np.ndarray, "q q"],
    n: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "n q"]:
    """Gaussian draws inside the bounds of the parameters."""
    declared = parameters(model)
    low, high = np.array([declared[name].bounds for name in names]).T
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    found = np.empty((0, len(names)))
    for _ in range(_ROUNDS):
        more = centre + rng.normal(size=(2 * n, len(names))) @ root.T
        found = np.concatenate([found, more[((more >= low) & (more <= high)).all(axis=1)]])
        if len(found) >= n:
            return found[:n]
    # A posterior that lies mostly outside: its draws end at the bounds.
    more = centre + rng.normal(size=(n - len(found), len(names))) @ root.T
    return np.concatenate([found, np.clip(more, low, high)])


def _log_ratios(
    result: FitRecord,
    model: AbstractSurface,
    names: Sequence[str],
    values: Float[np.ndarray, "n q"],
    centre: Float[np.ndarray, " q"],
) -> Float[np.ndarray, " n"]:
    """Logarithms of the likelihood over its Gaussian approximation, up to a constant.

    The two differ because distances are no linear function of the parameters. Edges and density count as
    Gaussian.
    """
    (part,) = result.agreements
    assert isinstance(part.target, PointCloud)
    assert part.uv is not None
    some = np.flatnonzero(part.weights > 0)
    some = some[np.linspace(0, len(some) - 1, min(_POINTS, len(some))).astype(int)]
    data, uv, here, by_value = Linear.of(
        model, names, part.target, part.weights, part.noise, part.uv, some
    )
    slopes = here.slopes * by_value
    weights = data.weights / part.noise**2
    gradient = slopes.T @ (weights * here.distance)
    step = values - centre
    quadratic = 0.5 * np.sum(weights * (step @ slopes.T) ** 2, axis=1) + step @ gradient
    squares = np.asarray(_squares(batch_of(model, names, values), data.points, weights, uv))
    known = float(np.sum(weights * here.distance**2))
    return quadratic - 0.5 * (squares - known)


def _sum_of_squares(
    models: AbstractSurface,
    points: Float[Array, "n 3"],
    weights: Float[Array, " n"],
    uv: Float[Array, "n 2"],
) -> Float[Array, " k"]:
    """Weighted squared normal distances from many models, with foot points looked up near given ones."""

    def one(model: AbstractSurface) -> Array:
        places, _, _ = newton(model, points, uv, 1)
        return jnp.sum(weights * frame(model, places).distance(points) ** 2)

    return jax.lax.map(one, models)


_squares = Program(_sum_of_squares)
