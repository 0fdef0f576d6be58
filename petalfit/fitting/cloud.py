"""A cloud fit from nothing: outline, heights and ribs on a few points, then all points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import bucket, pad_to
from petalfit.components import PeonyPetal
from petalfit.fitting import peony_start, programs
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.peony_start import HEIGHTS, RIBS, with_values
from petalfit.fitting.rounds import AbstractObserved, Polished, minimise
from petalfit.residuals import AbstractTerm, Data, TangentDistance, perturbation
from petalfit.surfaces import AbstractSurface

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
        model: The petal, with the bias that curvature and noise cause removed.
        information: Fisher information of its free parameters.
        distance: Signed normal distances, shape (n,).
        beyond: Distance beyond the nearer edges, positive outside, shape (n,).
        uv: Foot points, shape (n, 2).
        sigma: Noise, given or estimated.
        rounds: How many rounds the solver made.
        moved: By how much the last ones moved, in standard errors, the largest over the directions.
        chi2: Comparable between starts: n log of the mean squared distance.
    """

    label: str
    model: PeonyPetal
    information: Float[np.ndarray, "p p"]
    distance: Float[np.ndarray, " n"]
    beyond: Float[np.ndarray, " n"]
    uv: Float[np.ndarray, "n 2"]
    sigma: float
    rounds: int
    moved: float
    chi2: float


def pad(points: np.ndarray, weights: np.ndarray, noise: float | None) -> Data:
    """A cloud of a bucketed size; the padding repeats the first point with weight zero."""
    size = bucket(len(points))
    return Data(
        jnp.asarray(pad_to(points, size)),
        jnp.asarray(np.concatenate([weights, np.zeros(size - len(weights))])),
        jnp.asarray(np.nan if noise is None else float(noise)),
    )


@dataclasses.dataclass(frozen=True)
class ObservedCloud(AbstractObserved):
    """A cloud, as the rounds need it."""

    data: Data

    def at(self, uv: Float[Array, "n 2"]) -> TangentDistance:
        """Its term with these foot points and the noise still to be estimated."""
        return TangentDistance(data=self.data, uv=uv, sigma=self.data.sigma)

    def look(self, model: AbstractSurface, term: AbstractTerm | None) -> TangentDistance:
        assert isinstance(model, PeonyPetal)
        points = self.data.points
        if term is None:
            return self.at(programs.refine(model, points, plane_feet(model, points), 2))
        assert isinstance(term, TangentDistance)
        uv = programs.refine(model, points, term.uv, 2)
        return TangentDistance(data=self.data, uv=uv, sigma=term.sigma)

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        assert isinstance(term, TangentDistance)
        seen = programs.survey(coordinates, self.data, t, term.uv)
        return np.asarray(seen.information), float(seen.sigma)


def plane_feet(petal: PeonyPetal, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """(u, v) of a petal straight below or above the points: a start for their foot points.

    Sought at the nearest place of the surface itself, many would end on the wrong rib.
    """
    flat = peony_start.flat(petal)
    below = np.asarray(points) * np.array([1.0, 1.0, 0.0])
    return programs.refine(flat, below, programs.nearest(flat, below), 6)


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
    everything, used = points, weights > 0
    points, weights = points[used], weights[used]
    order = np.random.default_rng(seed).permutation(len(points))
    if from_template:
        starts = [("given", coordinates.template)]
    else:
        starts = [*_starts(coordinates, points, weights, order, noise, progress)]
    ends = []
    for label, model in starts:
        progress(f"polishing from {label}")
        ends.append(_settle(coordinates, label, model, points, weights, order, noise))
    best, *others = sorted(ends, key=lambda end: end.chi2)
    return [_with_unused(coordinates, best, everything, used), *others]


def _with_unused(
    coordinates: Coordinates[PeonyPetal], end: Settled, points: np.ndarray, used: np.ndarray
) -> Settled:
    """The distances of all points, those without weight included."""
    if used.all():
        return end
    rest = np.flatnonzero(~used)
    data = pad(points[rest], np.ones(len(rest)), end.sigma)
    uv = programs.refine(end.model, data.points, plane_feet(end.model, data.points), 3)
    seen = programs.survey(coordinates, data, coordinates.inverse(end.model), uv)

    def all_points(of_used: np.ndarray, of_rest: np.ndarray) -> np.ndarray:
        full = np.empty((len(points), *of_used.shape[1:]))
        full[used], full[rest] = of_used[: len(points) - len(rest)], of_rest[: len(rest)]
        return full

    return end._replace(
        distance=all_points(end.distance, np.asarray(seen.distance)),
        beyond=all_points(end.beyond, np.max(np.asarray(seen.beyond), axis=-1)),
        uv=all_points(end.uv, np.asarray(uv)),
    )


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
    some = order[:_START_POINTS]
    data = pad(points[some], weights[some], None)
    progress("searching the outline")
    outline, complete = peony_start.fit_outline(template, free, points[some])
    polished = _smooth(coordinates, outline, data)
    if "b_y" in free and not complete:
        # Without its tip a petal has the outline of a shorter one: look at several lengths.
        rest = [name for name in free if name != "b_y"]
        for length in _LENGTHS:
            longer = with_values(template, {"b_y": length})
            outline, _ = peony_start.fit_outline(longer, rest, points[some])
            polished = min(
                polished, _smooth(coordinates, outline, data), key=lambda start: start.sigma
            )
    smooth = polished.model
    held = coordinates.holding(RIBS).around(smooth)
    if not set(RIBS) & set(free):
        yield "the outline", with_values(smooth, {"rib_amplitude": template.rib_amplitude})
        return
    progress("searching the rib frequency")
    (term,) = polished.terms
    assert isinstance(term, TangentDistance)
    uv = programs.refine(smooth, data.points, term.uv, 2)
    seen = programs.survey(held, data, held.inverse(smooth), uv)
    basins = peony_start.rib_periodogram(
        None if "rib_frequency" in free else float(template.rib_frequency),
        *map(np.asarray, (seen.distance, seen.normal, data.weights, uv)),
    )
    for frequency, amplitude, gain in basins:
        if basins[0].gain - gain <= _CLEAR_LEAD:
            ribs = {"rib_frequency": frequency, "rib_amplitude": amplitude}
            yield f"rib_frequency {frequency:.2f}", with_values(smooth, ribs)


def _smooth(coordinates: Coordinates[PeonyPetal], outline: PeonyPetal, data: Data) -> Polished:
    """A petal without ribs, from its outline."""
    rough, uv = _with_heights(coordinates, outline, data)
    held = coordinates.holding(RIBS).around(with_values(rough, {"rib_amplitude": 0.0}))
    cloud = ObservedCloud(data)
    return minimise(held, [cloud], held.template, [cloud.at(uv)], 8, 1.0)


def _with_heights(
    coordinates: Coordinates[PeonyPetal], outline: PeonyPetal, data: Data
) -> tuple[PeonyPetal, Array]:
    """The petal with the heights that its outline leaves, and foot points straight below the data."""
    names = [name for name in HEIGHTS if name in coordinates.free]
    flat = with_values(outline, dict.fromkeys((*names, "rib_amplitude"), 0.0))
    uv = plane_feet(flat, data.points)
    if not names:
        return flat, uv
    here = coordinates.around(flat)
    t = here.inverse(flat)
    seen = programs.survey(here, data, t, uv)
    # Straight above its foot a point has the distance n_z (z - S_z), and S_z is linear in the heights.
    n_z = np.asarray(seen.normal)[:, 2]
    n_z = np.where(np.abs(n_z) > 1e-3, n_z, np.inf)
    columns = [coordinates.free.index(name) for name in names]
    basis = -np.asarray(seen.slopes)[:, columns] / here.slopes(t)[columns] / n_z[:, None]
    heights, weights = np.asarray(seen.distance) / n_z, np.asarray(data.weights)
    amplitudes = peony_start.fit_amplitudes(heights, basis, weights)
    return with_values(flat, dict(zip(names, amplitudes, strict=True))), uv


def _settle(
    coordinates: Coordinates[PeonyPetal],
    label: str,
    model: PeonyPetal,
    points: np.ndarray,
    weights: np.ndarray,
    order: np.ndarray,
    noise: float | None,
) -> Settled:
    """Polish on ever more points: each stage starts within a few standard errors of its end."""
    if len(order) > 2 * _START_POINTS:
        some = order[:_START_POINTS]
        data = pad(points[some], weights[some], noise)
        cloud = ObservedCloud(data)
        start = cloud.at(plane_feet(model, data.points))
        model = minimise(coordinates, [cloud], model, [start], 10, 0.1).model
    data = pad(points, weights, noise)
    some = order[:_BIAS_POINTS]
    sample = data if len(order) <= _BIAS_POINTS else pad(points[some], weights[some], noise)
    cloud = ObservedCloud(data)
    start = cloud.at(plane_feet(model, data.points))
    polished = minimise(coordinates, [cloud], model, [start], _ROUNDS, _TOLERANCE)
    return _finish(coordinates, label, polished, data, sample)


def _finish(
    coordinates: Coordinates[PeonyPetal],
    label: str,
    polished: Polished,
    data: Data,
    sample: Data,
) -> Settled:
    """Remove the bias, and look at the result with converged foot points.

    Args:
        coordinates: The free parameters.
        label: Of the start.
        polished: Where the solver stopped.
        data: The cloud.
        sample: The cloud, or a part of it that is large enough to measure the bias on.
    """
    model, t = polished.model, coordinates.inverse(polished.model)
    (term,) = polished.terms
    assert isinstance(term, TangentDistance)
    uv = programs.refine(model, data.points, term.uv, 1)
    seen = programs.survey(coordinates, data, t, uv)
    information = np.asarray(seen.information)
    places, position = uv, np.asarray(seen.position)
    if sample is not data:
        places = plane_feet(model, sample.points)
        places = programs.refine(model, sample.points, places, 3)
        position = np.asarray(programs.survey(coordinates, sample, t, places).position)
    noise = polished.sigma * perturbation(np.asarray(places))
    weights, sample_weights = np.asarray(data.weights), np.asarray(sample.weights)
    score = np.zeros(len(t))
    for moved in (position + noise, position - noise):
        around = sample._replace(points=jnp.asarray(moved))
        feet = programs.refine(model, moved, places, 3)
        blurred = programs.survey(coordinates, around, t, feet)
        score += np.asarray(blurred.slopes).T @ (sample_weights * np.asarray(blurred.distance)) / 2
    share = np.sum(sample_weights) / np.sum(weights)
    score /= share * float(seen.sigma) ** 2
    values, slopes = coordinates.values(t), coordinates.slopes(t)
    step = np.linalg.solve(information + np.eye(len(t)), score)
    # A bias of more than a few standard errors is not a small correction any more.
    size = np.sqrt(step @ information @ step / len(step))
    if np.isfinite(size):
        t = t + step * min(1.0, 3.0 / max(size, 1e-300))
        # The foot points move only along the surface, which changes no distance to first order.
        seen = programs.survey(coordinates, data, t, uv)
        values = coordinates.values(t)
    distance, beyond = np.asarray(seen.distance), np.max(np.asarray(seen.beyond), axis=-1)
    residual = weights * (distance**2 + np.maximum(beyond, 0.0) ** 2)
    total = float(np.sum(weights))
    return Settled(
        label,
        with_values(coordinates.template, dict(zip(coordinates.free, values, strict=True))),
        information / np.outer(slopes, slopes),
        distance,
        beyond,
        np.asarray(uv),
        polished.sigma,
        polished.rounds,
        polished.moved,
        total * float(np.log(np.sum(residual) / total)),
    )


_ROUNDS = 30
_LENGTHS = (16.0, 21.0, 27.0, 35.0)
_TOLERANCE = 1e-2  # standard errors
