"""Where to start a peony petal in a known pose: outline first, then heights, then ribs.

The outline is a function of a_x, b_y and c alone, and the height above the plane is linear in the
amplitudes once (u, v) are known. What is left is the rib frequency, whose cost has many basins: a
periodogram of the residual heights finds them all at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.stats import qmc

from petalfit.components import PeonyPetal, parameters
from petalfit.surfaces import Scalar

OUTLINE = ("a_x", "b_y", "c")
HEIGHTS = ("c_z", "dx", "dy", "midrib_height", "tip_curl")
RIBS = ("rib_frequency", "rib_amplitude")
BASINS = 3

_DIRECTIONS = 32
_GENERATIONS = (512, 64, 64, 64)
_FREQUENCIES = np.arange(2.0, 56.0, 0.25)

_TYPICAL = {name: parameters(PeonyPetal)[name].typical for name in OUTLINE}
_LOW, _HIGH = np.array(list(_TYPICAL.values())).T
_BOUNDS = np.array([parameters(PeonyPetal)[name].bounds for name in OUTLINE]).T
_SOBOL = qmc.Sobol(3, scramble=False).random(max(_GENERATIONS))
_EDGE = np.linspace(-0.5, 0.5, 25)
_OUTLINE_UV = np.concatenate(
    [
        np.stack([_EDGE, np.zeros(25)], -1),
        np.stack([_EDGE, np.ones(25)], -1),
        np.stack([np.full(25, 0.5), _EDGE + 0.5], -1),
    ]
)


def flat(petal: PeonyPetal, outline: Float[Array, "3"] | None = None) -> PeonyPetal:
    """The petal with nothing rising from the plane z = 0, perhaps with another outline."""
    names = ("c_z", "dx", "dy", "rib_amplitude", "midrib_height", "tip_curl")
    petal = with_values(petal, dict.fromkeys(names, jnp.zeros(())))
    if outline is None:
        return petal
    return with_values(petal, dict(zip(OUTLINE, jnp.unstack(outline), strict=True)))


def with_values(petal: PeonyPetal, values: Mapping[str, Scalar]) -> PeonyPetal:
    """The petal with some of its parameters replaced."""
    return eqx.tree_at(lambda p: [getattr(p, name) for name in values], petal, [*values.values()])


def fit_outline(
    petal: PeonyPetal,
    free: dict[str, Array],
    points: Float[Array, "n 3"],
    weights: Float[Array, " n"],
) -> Float[Array, "3"]:
    """a_x, b_y and c whose outline has the support function of the points' x and y.

    Petals are symmetric about x = 0 (but for their scallops), so points are reflected there: half a
    petal shows the whole outline. A heavy-tailed score lets a missing part be missing. Low-discrepancy
    candidates over the typical ranges, then generations of them around the best.
    """
    angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    directions = jnp.stack([jnp.cos(angle), jnp.sin(angle)])

    def along(xy: Array) -> Array:
        return jnp.abs(xy[:, :1]) * jnp.abs(directions[0]) + xy[:, 1:2] * directions[1]

    # The farthest few of the points may be strays.
    farthest = jnp.where(weights[:, None] > 0, along(points), -jnp.inf).T
    target = jax.lax.top_k(farthest, 1 + len(points) // 128)[0][:, -1]
    tolerance = 0.01 * jnp.max(jnp.abs(target))

    @jax.vmap
    def score(outline: Array) -> Array:
        edge = flat(petal, outline)(*_OUTLINE_UV.T)[:, :2]
        return jnp.sum(jnp.log1p(((jnp.max(along(edge), 0) - target) / tolerance) ** 2))

    given = jnp.stack([getattr(petal, name) for name in OUTLINE])
    moves = jnp.stack([free[name] for name in OUTLINE])
    best = jnp.where(moves, 0.5 * (_LOW + _HIGH), given)
    for k, size in enumerate(_GENERATIONS):
        spread = moves * (_HIGH - _LOW) * 0.25**k
        candidates = jnp.clip(best + spread * (_SOBOL[:size] - 0.5), *_BOUNDS).at[0].set(best)
        best = candidates[jnp.argmin(score(candidates))]
    return best


def fit_heights(
    flat: PeonyPetal,
    petal: PeonyPetal,
    free: dict[str, Array],
    points: Float[Array, "n 3"],
    weights: Float[Array, " n"],
    uv: Float[Array, "n 2"],
) -> Float[Array, "5"]:
    """Amplitudes of `HEIGHTS` by robust linear least squares of z at known (u, v) of a flat petal.

    Those that are not free keep the values of `petal`.
    """

    def z(amplitudes: Array) -> Array:
        model = with_values(flat, dict(zip(HEIGHTS, jnp.unstack(amplitudes), strict=True)))
        return model.position(uv[:, 0], uv[:, 1])[:, 2]

    given = jnp.stack([getattr(petal, name) for name in HEIGHTS])
    moves = jnp.stack([free[name] for name in HEIGHTS]).astype(points.dtype)
    unit = jnp.eye(len(HEIGHTS))
    columns = jax.vmap(lambda direction: jax.jvp(z, (given,), (direction,))[1])(unit).T
    basis = columns * moves
    heights = points[:, 2] - columns @ (given * (1 - moves))

    def reweighted(_: Array, amplitudes: Array) -> Array:
        residual = heights - basis @ amplitudes
        scale = jnp.sum(weights * jnp.abs(residual)) / jnp.sum(weights) + 1e-300
        robust = weights / (1 + (residual / scale) ** 2)
        normal = basis.T @ (robust[:, None] * basis)
        ridge = 1e-9 * jnp.trace(normal) * unit + 1e-300 * unit
        return jnp.linalg.solve(normal + ridge, basis.T @ (robust * heights))

    amplitudes = jax.lax.fori_loop(0, 5, reweighted, jnp.zeros(len(HEIGHTS)))
    return jnp.where(moves > 0, amplitudes, given)


class RibBasins(NamedTuple):
    """The strongest peaks of the periodogram, best first.

    Attributes:
        frequency: rib_frequency at the peaks, shape (BASINS,).
        amplitude: Its rib_amplitude by linear least squares.
        gain: How much a peak lowers Σ w d², in the unit of length squared.
        variance: Mean d² that the best peak leaves.
    """

    frequency: Float[Array, " k"]
    amplitude: Float[Array, " k"]
    gain: Float[Array, " k"]
    variance: Float[Array, ""]


def rib_periodogram(
    petal: PeonyPetal,
    frequency_is_free: Bool[Array, ""],
    points: Float[Array, "n 3"],
    weights: Float[Array, " n"],
    uv: Float[Array, "n 2"],
) -> RibBasins:
    """Frequencies that explain best the normal distances to a petal without ribs.

    Args:
        petal: A fitted petal with rib_amplitude 0.
        frequency_is_free: If not, its rib_frequency is the only one that is looked at.
        points: The cloud.
        weights: Weight of every point.
        uv: Foot points on `petal`.
    """
    u, v = uv[:, 0], uv[:, 1]
    normal = petal.normal(u, v)
    distance = jnp.sum(normal * (points - petal.position(u, v)), axis=-1)
    # The midrib's flanks are steep: there a small shift of u is a large distance.
    scale = jnp.sum(weights * jnp.abs(distance)) / jnp.sum(weights) + 1e-300
    robust = weights / (1 + (distance / (3 * scale)) ** 2)
    envelope = normal[:, 2] * (1 - 2 * jnp.abs(v - 0.5)) * (1 - 2 * jnp.abs(u))

    def at(frequency: Array) -> tuple[Array, Array]:
        wave = envelope * jnp.sin(frequency * (u + 0.5) * np.pi)
        covariance, variance = jnp.sum(robust * distance * wave), jnp.sum(robust * wave**2)
        return covariance**2 / (variance + 1e-300), covariance / (variance + 1e-300)

    # Three equal frequencies are a peak too: the fixed one.
    frequencies = jnp.where(frequency_is_free, _FREQUENCIES, petal.rib_frequency)
    gain, amplitude = jax.lax.map(at, frequencies, batch_size=24)
    before, after = jnp.pad(gain, (1, 0))[:-1], jnp.pad(gain, (0, 1))[1:]
    is_peak = (gain >= before) & (gain > after)
    best = jnp.argsort(jnp.where(is_peak, -gain, jnp.inf))[:BASINS]
    # The vertex of a parabola through a peak and its neighbours.
    curvature = before + after - 2 * gain
    vertex = jnp.where(curvature < 0, 0.5 * (before - after) / curvature, 0.0)
    step = frequencies[1] - frequencies[0]
    frequency = frequencies + step * jnp.clip(vertex, -0.5, 0.5)
    total = jnp.sum(robust * distance**2)
    gain = jnp.where(is_peak, gain, -jnp.inf)
    variance = (total - gain[best[0]]) / jnp.sum(robust)
    return RibBasins(frequency[best], amplitude[best], gain[best], variance)
