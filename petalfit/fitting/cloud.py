"""A cloud fit from nothing: outline, heights and ribs on a few points, then all points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import bucket, pad_to
from petalfit.components import PeonyPetal
from petalfit.fitting import peony_start, programs
from petalfit.fitting.coordinates import Coordinates, Model, with_values
from petalfit.fitting.determined import stay_at_the_start
from petalfit.fitting.peony_start import HEIGHTS, RIBS
from petalfit.fitting.rounds import (
    AbstractObserved,
    Account,
    Polished,
    Progress,
    Seen,
    Settled,
    finish,
    minimise,
)
from petalfit.fitting.solve import Prior
from petalfit.fitting.view_start import Shadow, search
from petalfit.observations import PointCloud
from petalfit.residuals import AbstractTerm, Data, TangentDistance, perturbation
from petalfit.surfaces import AbstractSurface

# Points that a start is found with. Enough for the ribs, which are fine; and small clouds are fitted
# with programs of a single size.
_START_POINTS = 1536
_BIAS_POINTS = 6144
# Rivals of the best rib frequency are followed if the periodogram prefers it by less than this in χ².
_CLEAR_LEAD = 50.0


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
    """A cloud, as the rounds need it.

    Attributes:
        data: The cloud.
        sample: A part of it that is large enough to measure the bias on; None for all of it.
    """

    data: Data
    sample: Data | None = None

    @classmethod
    def of(
        cls, points: np.ndarray, weights: np.ndarray, noise: float | None, order: np.ndarray
    ) -> ObservedCloud:
        """A cloud with a part of it, the first ones in `order`, that is enough to measure a bias on."""
        some = order[:_BIAS_POINTS]
        sample = None if len(order) <= _BIAS_POINTS else pad(points[some], weights[some], noise)
        return cls(pad(points, weights, noise), sample)

    @classmethod
    def used(
        cls, cloud: PointCloud, noise: float | None, rng: np.random.Generator
    ) -> ObservedCloud:
        """The points of a cloud that have a weight."""
        weights = np.ones(len(cloud)) if cloud.weights is None else cloud.weights
        some = weights > 0
        order = rng.permutation(np.count_nonzero(some))
        return cls.of(cloud.points[some], weights[some], noise, order)

    def misfit(self, model: AbstractSurface) -> float:
        """Mean logarithm of 1 + d², with d in hundredths of the cloud's extent."""
        term = self.look(model, None)
        distance = programs.distances(model, self.data.points, term.uv)
        return mean_logarithm(self.data, np.asarray(distance), np.asarray(self.data.weights))

    def at(self, uv: Float[Array, "n 2"]) -> TangentDistance:
        """Its term with these foot points and the noise still to be estimated."""
        return TangentDistance(data=self.data, uv=uv, sigma=self.data.sigma)

    def look(self, model: AbstractSurface, term: AbstractTerm | None) -> TangentDistance:
        points = self.data.points
        if term is None:
            return self.at(programs.refine(model, points, feet(model, points), 2))
        assert isinstance(term, TangentDistance)
        uv = programs.refine(model, points, term.uv, 2)
        return TangentDistance(data=self.data, uv=uv, sigma=term.sigma)

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        assert isinstance(term, TangentDistance)
        seen = programs.survey(coordinates, self.data, t, term.uv)
        return np.asarray(seen.information), float(seen.sigma)

    def account(self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm) -> Account:
        """With the score that noise and curvature cause; see `petalfit.residuals.curvature_bias`."""
        assert isinstance(term, TangentDistance)
        data, sample, model = self.data, self.sample or self.data, coordinates.model(t)
        uv = programs.refine(model, data.points, term.uv, 1)
        seen = programs.survey(coordinates, data, t, uv)
        places, position = uv, np.asarray(seen.position)
        if sample is not data:
            places = feet(model, sample.points)
            places = programs.refine(model, sample.points, places, 3)
            position = np.asarray(programs.survey(coordinates, sample, t, places).position)
        noise = float(term.sigma) * perturbation(np.asarray(places))
        weights = np.asarray(sample.weights)
        score = np.zeros(len(t))
        for moved in (position + noise, position - noise):
            around = sample._replace(points=jnp.asarray(moved))
            blurred = programs.survey(
                coordinates, around, t, programs.refine(model, moved, places, 3)
            )
            score += np.asarray(blurred.slopes).T @ (weights * np.asarray(blurred.distance)) / 2
        share = np.sum(weights) / np.sum(np.asarray(data.weights))
        score /= share * float(seen.sigma) ** 2
        information = np.asarray(seen.information)
        term = TangentDistance(data=data, uv=uv, sigma=term.sigma)
        return Account(term, information, score, information)

    def seen(self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm) -> list[Seen]:
        assert isinstance(term, TangentDistance)
        seen = programs.survey(coordinates, self.data, t, term.uv)
        distance = np.asarray(seen.distance)
        beyond = np.maximum(np.max(np.asarray(seen.beyond), axis=-1), 0.0)
        off = np.where(beyond > 0, np.copysign(np.hypot(distance, beyond), distance), distance)
        weights = np.asarray(self.data.weights)
        chi2 = comparable(off, weights)
        return [Seen(off, weights, float(term.sigma), "length", chi2, np.asarray(term.uv))]


def mean_logarithm(data: Data, distances: np.ndarray, weights: np.ndarray) -> float:
    """Of 1 + d², with distances d in hundredths of the cloud's extent; small where most are."""
    extent = 0.01 * np.linalg.norm(np.ptp(np.asarray(data.points), axis=0))
    return float(np.average(np.log1p((distances / extent) ** 2), weights=weights))


def comparable(distances: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    """A χ² that compares ends of one cloud: n log of the mean squared distance."""
    total = float(np.sum(weights))
    with np.errstate(divide="ignore"):
        return total * float(np.log(np.sum(weights * distances**2) / total))


def feet(model: AbstractSurface, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """(u, v) near the points: a start for their foot points.

    Of a petal straight below or above them: sought at the nearest place of the surface itself, many
    would end on the wrong rib.
    """
    if not isinstance(model, PeonyPetal):
        return programs.refine(model, points, programs.nearest(model, points), 6)
    petal = model
    flat = peony_start.flat(petal)
    below = np.asarray(points) * np.array([1.0, 1.0, 0.0])
    return programs.refine(flat, below, programs.nearest(flat, below), 6)


def fit_cloud(
    template: Model,
    free: tuple[str, ...],
    points: np.ndarray,
    weights: np.ndarray,
    *,
    noise: float | None,
    from_template: bool,
    seed: int,
    progress: Progress,
) -> list[Settled[Model]]:
    """Fit a component in the cloud's own frame.

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
    cloud = PointCloud(points, weights=weights)
    used = weights > 0
    points, weights = points[used], weights[used]
    order = np.random.default_rng(seed).permutation(len(points))
    if from_template:
        starts = [("given", coordinates.template)]
    elif isinstance(template, PeonyPetal):
        starts = [*_starts(coordinates, points, weights, order, noise, progress)]
    else:
        starts = component_starts(coordinates, _whole, points, weights, order, progress)

    def settle(label: str, model: AbstractSurface, prior: Prior | None) -> Settled[Model]:
        return _settle(coordinates, label, model, points, weights, order, noise, prior)

    best, *others = follow(coordinates, starts, settle, progress)
    return [with_all_points(coordinates, best, 0, cloud), *others]


def follow(
    coordinates: Coordinates,
    starts: Sequence[tuple[str, AbstractSurface]],
    settle: Callable[[str, AbstractSurface, Prior | None], Settled],
    progress: Progress,
) -> list[Settled]:
    """Where starts end, the best first; in that, what is not determined stays at the template's values.

    Args:
        coordinates: The free parameters.
        starts: With their labels.
        settle: From a start to its end, with what is known besides.
        progress: Called with a line of text for each start.
    """
    ends = []
    for label, model in starts:
        progress(f"polishing from {label}")
        ends.append(settle(label, model, None))
    best, *others = sorted(ends, key=lambda end: end.chi2)

    def again(model: AbstractSurface, _: Polished | None, prior: Prior | None) -> Settled:
        return settle(best.label, model, prior)

    return [stay_at_the_start(coordinates, best, again), *others]


def with_all_points(
    coordinates: Coordinates, end: Settled, number: int, cloud: PointCloud
) -> Settled:
    """An end with all points of a cloud as they came, those without weight included.

    Args:
        coordinates: The free parameters.
        end: Its observation of that number is of the points with weight, padded.
        number: Of the observation.
        cloud: The cloud.
    """
    seen = end.seen[number]
    assert seen.uv is not None
    size = len(cloud)
    given = np.ones(size) if cloud.weights is None else cloud.weights
    used = given > 0
    count = np.count_nonzero(used)
    distance, uv = np.empty(size), np.empty((size, 2))
    distance[used], uv[used] = seen.distance[:count], seen.uv[:count]
    if count < size:
        data = pad(cloud.points[~used], np.ones(size - count), seen.noise)
        uv_rest = programs.refine(end.model, data.points, feet(end.model, data.points), 3)
        others = ObservedCloud(data)
        t = coordinates.inverse(end.model)
        (rest,) = others.seen(coordinates, t, others.at(uv_rest))
        assert rest.uv is not None
        distance[~used], uv[~used] = rest.distance[: size - count], rest.uv[: size - count]
    seen = seen._replace(distance=distance, weights=np.array(given, float), uv=uv)
    parts = (*end.seen[:number], seen, *end.seen[number + 1 :])
    return dataclasses.replace(end, seen=parts)


def _whole(points: np.ndarray, weights: np.ndarray, noise: float | None) -> ObservedCloud:
    return ObservedCloud(pad(points, weights, noise))


def component_starts(
    coordinates: Coordinates,
    observe: Callable[[np.ndarray, np.ndarray, float | None], AbstractObserved],
    points: np.ndarray,
    weights: np.ndarray,
    order: np.ndarray,
    progress: Progress,
) -> list[tuple[str, AbstractSurface]]:
    """Starts of any component: as far as the points in all directions, then near to them."""
    progress("searching the extent")
    some = order[:_START_POINTS]
    # Three views along the axes know how far a body reaches in space.
    shadows = [
        Shadow(np.vstack([np.hstack([np.delete(np.eye(3), k, 0), np.zeros((2, 1))]), _FLAT]),
               np.delete(points[some], k, 1), weights[some])
        for k in range(3)
    ]  # fmt: skip
    cloud = observe(points[some], weights[some], None)
    found = []
    for t in search(coordinates, shadows, _CANDIDATES):
        model = minimise(coordinates, [cloud], coordinates.model(t), [None], 4, 0.5).model
        found.append((cloud.misfit(model), model))
    found.sort(key=lambda start: start[0])
    different: list[tuple[str, AbstractSurface]] = []
    for _, model in found:
        t = coordinates.inverse(model)
        apart = [np.max(np.abs(t - coordinates.inverse(other))) > _SAME for _, other in different]
        if all(apart):
            different.append((f"extent {len(different) + 1}", model))
        if len(different) == _FOLLOWED:
            break
    return different


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
                polished,
                _smooth(coordinates, outline, data),
                key=lambda start: float(start.terms[0].sigma),
            )
    smooth = polished.model
    if not set(RIBS) & set(free):
        yield "the outline", with_values(smooth, {"rib_amplitude": template.rib_amplitude})
        return
    progress("searching the rib frequency")
    yield from rib_starts(coordinates, smooth, ObservedCloud(data), polished.terms[0])


def rib_starts(
    coordinates: Coordinates[PeonyPetal],
    smooth: PeonyPetal,
    cloud: ObservedCloud,
    term: AbstractTerm | None = None,
) -> Iterator[tuple[str, PeonyPetal]]:
    """A petal without ribs with those that a cloud's distances to it speak for."""
    held = coordinates.holding(RIBS).around(smooth)
    data, uv = cloud.data, cloud.look(smooth, term).uv
    seen = programs.survey(held, data, held.inverse(smooth), uv)
    fixed = "rib_frequency" not in coordinates.free
    basins = peony_start.rib_periodogram(
        float(coordinates.template.rib_frequency) if fixed else None,
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
    uv = feet(flat, data.points)
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
    coordinates: Coordinates,
    label: str,
    model: AbstractSurface,
    points: np.ndarray,
    weights: np.ndarray,
    order: np.ndarray,
    noise: float | None,
    prior: Prior | None = None,
) -> Settled:
    """Polish on ever more points: each stage starts within a few standard errors of its end."""
    if len(order) > 2 * _START_POINTS:
        some = order[:_START_POINTS]
        data = pad(points[some], weights[some], noise)
        cloud = ObservedCloud(data)
        start = cloud.at(feet(model, data.points))
        model = minimise(coordinates, [cloud], model, [start], 10, 0.1, prior).model
    cloud = ObservedCloud.of(points, weights, noise, order)
    data = cloud.data
    start = cloud.at(feet(model, data.points))
    polished = minimise(coordinates, [cloud], model, [start], _ROUNDS, _TOLERANCE, prior)
    return finish(coordinates, label, [cloud], polished, prior)


_FLAT = np.array([[0.0, 0.0, 0.0, 1.0]])  # the last row of an orthographic camera
_CANDIDATES = 12
_FOLLOWED = 2
_SAME = 0.3  # coordinates closer than this are one start
_ROUNDS = 30
_LENGTHS = (16.0, 21.0, 27.0, 35.0)
_TOLERANCE = 1e-2  # standard errors
