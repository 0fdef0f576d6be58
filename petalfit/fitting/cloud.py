"""A cloud fit from nothing: outline, heights and ribs on a few points, then all points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from petalfit.components import PeonyPetal
from petalfit.fitting import peony_start, programs
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.peony_start import HEIGHTS, OUTLINE, RIBS, with_values
from petalfit.fitting.solve import Data, State

# Points that a start is found with. Enough for the ribs, which are fine; and small clouds are fitted
# with programs of a single size.
_START_POINTS = 1536
_BIAS_POINTS = 6144
# Rivals of the best rib frequency are followed if the periodogram prefers it by less than this in χ².
_CLEAR_LEAD = 50.0

Progress = Callable[[str], None]


class Settled(NamedTuple):
    """One start, followed to its end.

    Attributes:
        label: What distinguishes the start.
        state: Where the solver stopped.
        finish: What is known there.
        model: The petal, its free parameters as fitted.
        chi2: Comparable between starts: n log of the mean squared distance.
    """

    label: str
    state: State
    finish: programs.Finish
    model: PeonyPetal
    chi2: float


def bucket(n: int) -> int:
    """The size that n points are padded to: 64, 96, 128, 192, 256, …, so that few sizes compile."""
    power = max(64, 1 << (n - 1).bit_length())
    return power * 3 // 4 if n <= power * 3 // 4 and power > 64 else power


def pad(points: np.ndarray, weights: np.ndarray, noise: float | None) -> Data:
    """A cloud of a bucketed size; the padding repeats the first point with weight zero."""
    extra = bucket(len(points)) - len(points)
    return Data(
        jnp.asarray(np.concatenate([points, np.repeat(points[:1], extra, axis=0)])),
        jnp.asarray(np.concatenate([weights, np.zeros(extra)])),
        jnp.asarray(np.nan if noise is None else float(noise)),
    )


def fit_cloud(
    template: PeonyPetal,
    free: tuple[str, ...],
    points: np.ndarray,
    weights: np.ndarray,
    *,
    noise: float | None,
    from_template: bool,
    seed: int,
    progress: Progress,
) -> list[Settled]:
    """Fit a peony petal in the cloud's own frame.

    Args:
        template: Values of the fixed parameters; of all parameters if `from_template`.
        free: Names of the parameters to fit.
        points: Shape (n, 3), finite.
        weights: Shape (n,), not all zero.
        noise: σ, or None to estimate it.
        from_template: Start at the template instead of searching.
        seed: Of the choice of points for the start.
        progress: Called with a line of text when a stage begins.

    Returns:
        What each start reached, the best first. Call it inside `jax.enable_x64(True)`.
    """
    coordinates = Coordinates.of(template, free)
    if from_template:
        starts = [("given", coordinates.template)]
    else:
        order = np.random.default_rng(seed).permutation(np.flatnonzero(weights > 0))
        starts = [*_starts(coordinates, points, weights, order, noise, progress)]
    ends = []
    for label, model in starts:
        progress(f"polishing from {label}")
        ends.append(_settle(coordinates, label, model, points, weights, noise, seed))
    return sorted(ends, key=lambda end: end.chi2)


def _starts(
    coordinates: Coordinates[PeonyPetal],
    points: np.ndarray,
    weights: np.ndarray,
    order: np.ndarray,
    noise: float | None,
    progress: Progress,
) -> Iterator[tuple[str, PeonyPetal]]:
    """Petals to polish: one for each rib frequency that the cloud leaves open."""
    template, free = coordinates.template, coordinates.free
    is_free = {name: jnp.asarray(name in free) for name in vars(template)}
    some = order[:_START_POINTS]
    data = pad(points[some], weights[some], None)
    progress("searching the outline")
    outline = programs.fit_outline(template, is_free, data.points, data.weights)
    flat = peony_start.flat(template, outline)
    uv = programs.plane_feet(flat, data.points)
    heights = programs.fit_heights(flat, template, is_free, data.points, data.weights, uv)
    names = (*OUTLINE, *HEIGHTS)
    values = [*jnp.unstack(outline), *jnp.unstack(heights)]
    smooth = with_values(template, dict(zip(names, values, strict=True)))
    smooth = with_values(smooth, {"rib_amplitude": jnp.zeros(())})
    held = coordinates.holding(RIBS)
    held = eqx.tree_at(lambda c: c.template, held, smooth)
    state = programs.solve_compiled(held, data, held.inverse(held.gather(smooth)), uv, 6, 3.0)
    smooth = with_values(held.model(state.t), {"rib_amplitude": jnp.zeros(())})
    if not set(RIBS) & set(free):
        yield "the outline", with_values(smooth, {"rib_amplitude": template.rib_amplitude})
        return
    progress("searching the rib frequency")
    uv = programs.refine(smooth, data.points, state.uv, 2)
    basins = programs.find_ribs(smooth, is_free["rib_frequency"], data.points, data.weights, uv)
    lead = (basins.gain[0] - basins.gain) / basins.variance
    for frequency, amplitude, behind in zip(basins.frequency, basins.amplitude, lead, strict=True):
        if behind <= _CLEAR_LEAD:
            label = f"rib_frequency {float(frequency):.2f}"
            ribs = {"rib_frequency": frequency, "rib_amplitude": amplitude}
            yield label, with_values(smooth, ribs)


def _settle(
    coordinates: Coordinates[PeonyPetal],
    label: str,
    model: PeonyPetal,
    points: np.ndarray,
    weights: np.ndarray,
    noise: float | None,
    seed: int,
) -> Settled:
    """Polish on ever more points: each stage starts within a few standard errors of its end."""
    t = coordinates.inverse(coordinates.gather(model))
    order = np.random.default_rng(seed).permutation(np.flatnonzero(weights > 0))
    if len(order) > 2 * _START_POINTS:
        some = order[:_START_POINTS]
        data = pad(points[some], weights[some], noise)
        uv = programs.plane_feet(coordinates.model(t), data.points)
        t = programs.solve_compiled(coordinates, data, t, uv, 10, 0.1).t
    data = pad(points, weights, noise)
    some = order[:_BIAS_POINTS]
    sample = data if len(order) <= _BIAS_POINTS else pad(points[some], weights[some], noise)
    uv = programs.plane_feet(coordinates.model(t), data.points)
    state = programs.solve_compiled(coordinates, data, t, uv, _ROUNDS, _TOLERANCE)
    finish = programs.finish(coordinates, data, state, sample)
    values = dict(zip(coordinates.free, finish.values, strict=True))
    residual = data.weights * (finish.distance**2 + jnp.maximum(finish.beyond, 0.0) ** 2)
    total = float(jnp.sum(data.weights))
    chi2 = total * float(jnp.log(jnp.sum(residual) / total))
    return Settled(label, state, finish, with_values(coordinates.template, values), chi2)


_ROUNDS = 30
_TOLERANCE = 1e-2  # standard errors
