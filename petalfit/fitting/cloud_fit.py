"""A cloud fit from nothing: pose, outline, heights and ribs on a few points, then all points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import stage
from petalfit.components import PeonyPetal, Posed
from petalfit.fitting import peony_start, programs
from petalfit.fitting.canonical import Canonical
from petalfit.fitting.cloud import ObservedCloud, feet, pad, with_all_points
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.determined import stay_at_the_start
from petalfit.fitting.patches import Patches
from petalfit.fitting.peony_pose import Placed, placed_petals
from petalfit.fitting.peony_start import RIBS, RibBasin, close
from petalfit.fitting.robust import Cleared, Clutter, approach, clear
from petalfit.fitting.rounds import (
    AbstractObserved,
    Polished,
    Progress,
    Settled,
    Surface,
    finish,
    minimise,
)
from petalfit.fitting.scan import Scan
from petalfit.fitting.solve import Prior
from petalfit.fitting.view_start import Shadow, search
from petalfit.observations import PointCloud
from petalfit.residuals import AbstractTerm, Data
from petalfit.surfaces import AbstractSurface, Pose, turn_between, value_at

# Points that a start is found with. Enough for the ribs, which are fine; and small clouds are fitted
# with programs of a single size.
START_POINTS = 1536
_APPROACH_POINTS = 2048
# Gain in χ² of ribs in what a right end leaves: by chance alone, the best of 200 frequencies has 10.
_RIBS_LEFT = 20.0
# Poses that are tried at first, and along the normal of the best of these; more in an unknown unit or
# among clutter.
_TRIED, _TRIED_IN_DOUBT = (3, 0), (4, 3)
# Poses whose logarithm of the likelihood is worse by more than this part of the points are not followed.
_HOPELESS = 0.05
_SAME_TURN = 0.1  # rad
_FEWEST = 64  # points from which a plane and an outline can be told
_TYPICAL_EXTENT = 10.0  # root mean square distance of a petal's points from their middle


def fit_cloud(
    template: AbstractSurface,
    free: tuple[str, ...],
    points: np.ndarray,
    weights: np.ndarray,
    *,
    pose: str = "known",
    loss: str = "linear",
    noise: float | None,
    from_template: bool,
    seed: int,
    progress: Progress,
) -> tuple[AbstractSurface, tuple[str, ...], list[Settled]]:
    """Fit a component in the cloud's own frame, or a petal in an unknown pose.

    Args:
        template: Values of the fixed parameters; of all parameters if `from_template`.
        free: Names of the parameters to fit.
        points: Shape (n, 3), finite.
        weights: Shape (n,), not all zero.
        pose: "known"; "rigid" or "similarity" for a PeonyPetal.
        loss: "linear" or "robust".
        noise: σ, or None to estimate it.
        from_template: Start at the template instead of searching.
        seed: Of the choice of points for the start.
        progress: Called with a line of text when a stage begins.

    Returns:
        The template, perhaps posed; the names of all that is free; and what each start reached, the best
        first. Call it inside `jax.enable_x64(True)`.
    """
    cloud = PointCloud(points, weights=weights)
    used = weights > 0
    frame = Canonical.of(points[used], pose)
    if pose == "similarity":
        # As large as petals usually are in the model's unit.
        frame = dataclasses.replace(frame, unit=frame.unit / _TYPICAL_EXTENT)
    noise = None if noise is None else noise / frame.unit
    own, weights = frame.into(points[used]), weights[used]
    scan = Scan.of(own, weights, frame.order(own, seed), noise, loss)
    if pose == "known":
        coordinates = Coordinates.of(template, free)
        ends = _from_known(coordinates, scan, from_template, progress)
    else:
        assert isinstance(template, PeonyPetal)
        # Where it lies along its normal is the pose's to say.
        free = tuple(name for name in free if name != "c_z")
        found = _from_anywhere(template, free, pose, scan, progress)
        ends = [_in_target(end, frame) for end in found]
        free = (*free, *Posed.free_in(pose))
    best, *others = ends
    coordinates = Coordinates.of(best.model, free)
    return best.model, free, [with_all_points(coordinates, best, 0, cloud), *others]


def _in_target(end: Settled, frame: Canonical) -> Settled:
    """An end in the target's frame and unit."""
    assert isinstance(end.model, Posed)
    (seen,) = end.seen
    return dataclasses.replace(end, model=frame.back(end.model), seen=(frame.measured(seen),))


def _from_known(
    coordinates: Coordinates, scan: Scan, from_template: bool, progress: Progress
) -> list[Settled]:
    """Ends in the cloud's own frame."""
    if from_template:
        starts = [("given", coordinates.template)]
    elif isinstance(coordinates.template, PeonyPetal):
        starts = [*_starts(coordinates, scan, progress)]
    else:
        some = scan.some(START_POINTS)
        starts = component_starts(
            coordinates, _whole, scan.points[some], scan.weights[some], progress
        )

    spread = not isinstance(coordinates.template, PeonyPetal)

    def settle(label: str, model: AbstractSurface, prior: Prior | None) -> Settled:
        end = _settled(scan, coordinates, label, model, prior)
        return _spread_out(end, scan) if spread else end

    return follow(coordinates, starts, settle, progress)


def _spread_out(end: Settled, scan: Scan) -> Settled:
    """The end, compared with others by the chance of an even spread over its area too.

    A surface that goes on where no points are may follow the others as well as a shorter one.
    """
    area = float(np.sum(Patches.of(end.model).area))
    chance = 2 * float(np.sum(scan.weights) * np.log(max(area, 1e-300)))
    return dataclasses.replace(end, chi2=end.chi2 + chance)


def _from_anywhere(
    template: PeonyPetal, free: tuple[str, ...], pose: str, scan: Scan, progress: Progress
) -> list[Settled]:
    """Ends of the poses that the cloud leaves open."""
    names = (*free, *Posed.free_in(pose))
    progress("searching the pose")
    likely = scan.points[scan.some(START_POINTS)]
    smooth = template
    if "rib_amplitude" in free:
        smooth = with_values(template, {"rib_amplitude": 0.0})
    placed = placed_petals(smooth, free, likely, pose)
    some = scan.order[:_APPROACH_POINTS]
    points, weights = scan.points[some], scan.weights[some]
    clutter = scan.clutter or Clutter.around(scan.points)

    def approached(start: Placed) -> Cleared:
        posed = Posed(
            programs.numbers(start.petal), start.rotation, start.translation, np.float64(start.unit)
        )
        held = Coordinates.of(posed, names).holding(RIBS)
        return approach(held, clutter, posed, points, weights, scan.likely[some])

    found: list[Cleared] = []
    easy = pose == "rigid" and scan.clutter is None
    at_first, again = _TRIED if easy else _TRIED_IN_DOUBT
    for k, start in enumerate(placed[:at_first]):
        progress(f"approaching from pose {k + 1}")
        found.append(approached(start))
    best = max(found, key=_likelihood)
    if again and np.count_nonzero(best.mixture.members > 0.5) > _FEWEST:
        progress("looking again along its normal")
        inside = points[best.mixture.members > 0.5][:START_POINTS]
        placed = placed_petals(smooth, free, inside, pose, np.asarray(_placement(best).rotation))
        found += map(approached, placed[:again])
    found.sort(key=_likelihood, reverse=True)
    ends: list[Settled] = []
    for k, near in enumerate(found):
        lead = _likelihood(found[0]) - _likelihood(near)
        turned = [
            turn_between(_placement(near).rotation, _placement(other).rotation)
            for other in found[:k]
        ]
        if lead > _HOPELESS * len(points) or any(turn < _SAME_TURN for turn in turned):
            continue
        ends += _settled_poses(template, names, scan, near, f"pose {k + 1}", progress)
    return sorted(ends, key=lambda end: end.chi2)


def _settled_poses(
    template: PeonyPetal,
    names: tuple[str, ...],
    scan: Scan,
    near: Cleared,
    label: str,
    progress: Progress,
) -> list[Settled]:
    """Ends of one pose, one for each rib frequency that the cloud leaves open."""
    smooth = near.polished.model
    assert isinstance(smooth, Posed)
    coordinates = Coordinates.of(smooth.at_rest(programs.numbers(template)), names)
    smooth = smooth.at_rest(programs.numbers(smooth.surface))
    (term,) = near.polished.terms
    settled: list[Settled] = []

    def labelled(basin: RibBasin) -> tuple[str, AbstractSurface]:
        name, model = with_ribs(smooth, basin)
        return f"{label}, {name}", model

    def starts() -> Iterator[tuple[str, AbstractSurface]]:
        if not set(RIBS) & set(names):
            yield f"{label}, smooth", smooth
            return
        basins = ribs_beside(coordinates, smooth, near.cloud, term)
        # Among clutter a periodogram tells less: there all of them are followed.
        first = close(basins) if scan.clutter is None else basins
        yield from map(labelled, first)
        rest = basins[len(first) :]
        # Beside a smooth petal that is not quite the right one, ribs may seem to have another frequency.
        if rest and _ribs_left(coordinates, scan, min(settled, key=lambda end: end.chi2)):
            yield from map(labelled, rest)

    def settle(name: str, model: AbstractSurface, prior: Prior | None) -> Settled:
        settled.append(_settled(scan, coordinates, name, model, prior))
        return settled[-1]

    return follow(coordinates, starts(), settle, progress)


def _ribs_left(coordinates: Coordinates, scan: Scan, end: Settled) -> bool:
    """Whether other ribs would explain what an end leaves: then its own are the wrong ones."""
    (seen,) = end.seen
    assert seen.uv is not None
    data = pad(scan.points, np.asarray(seen.weights)[: len(scan.points)], seen.noise)
    return _explaining(coordinates.around(end.model), data, seen.uv)[0].gain > _RIBS_LEFT


def _likelihood(near: Cleared) -> float:
    return near.mixture.log_likelihood


def _placement(near: Cleared) -> Pose:
    assert isinstance(near.polished.model, Posed)
    return near.polished.model.placement


def _settled(
    scan: Scan,
    coordinates: Coordinates,
    label: str,
    model: AbstractSurface,
    prior: Prior | None,
) -> Settled:
    """Polish on ever more points: each stage starts within a few standard errors of its end."""
    if len(scan.order) > 2 * START_POINTS:
        some = scan.order[:START_POINTS]
        model = _polished(scan, coordinates, model, some, 10, 0.1, prior)[0].model
    polished, weights, log_likelihood = _polished(
        scan, coordinates, model, np.arange(len(scan.points)), _ROUNDS, _TOLERANCE, prior
    )
    cloud = ObservedCloud.of(scan.points, weights, scan.noise, scan.order)
    end = finish(coordinates, label, [cloud], polished, prior)
    if log_likelihood is None:
        return end
    return dataclasses.replace(end, chi2=-2 * log_likelihood)


def _polished(
    scan: Scan,
    coordinates: Coordinates,
    model: AbstractSurface,
    some: np.ndarray,
    rounds: int,
    tolerance: float,
    prior: Prior | None,
) -> tuple[Polished, np.ndarray, float | None]:
    """Where the solver stops on some points, their weights there, and their likelihood if robust."""
    points, weights, log_likelihood = scan.points[some], scan.weights[some], None
    if scan.clutter is not None:
        ends = clear(coordinates, scan.clutter, model, points, weights, scan.noise, prior)
        members, log_likelihood = weights * ends.mixture.members, ends.mixture.log_likelihood
        if np.sum(members) >= len(coordinates.free):
            return ends.polished, members, log_likelihood
        # No points are left that belong to it: how far it is from all of them is then the result.
        model, rounds = ends.polished.model, 1
    cloud = ObservedCloud(pad(points, weights, scan.noise))
    start = cloud.at(feet(model, cloud.data.points))
    polished = minimise(coordinates, [cloud], model, [start], rounds, tolerance, prior)
    return polished, weights, log_likelihood


def follow(
    coordinates: Coordinates,
    starts: Iterable[tuple[str, AbstractSurface]],
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
        with stage("polishing"):
            ends.append(settle(label, model, None))
    best, *others = sorted(ends, key=lambda end: end.chi2)

    def again(model: AbstractSurface, _: Polished | None, prior: Prior | None) -> Settled:
        return settle(best.label, model, prior)

    with stage("polishing"):
        return [stay_at_the_start(coordinates, best, again), *others]


def _whole(points: np.ndarray, weights: np.ndarray, noise: float | None) -> ObservedCloud:
    return ObservedCloud(pad(points, weights, noise))


def component_starts(
    coordinates: Coordinates,
    observe: Callable[[np.ndarray, np.ndarray, float | None], AbstractObserved],
    points: np.ndarray,
    weights: np.ndarray,
    progress: Progress,
) -> list[tuple[str, AbstractSurface]]:
    """Starts of any component: as far as some points in all directions, then near to them."""
    progress("searching the extent")
    # Three views along the axes know how far a body reaches in space.
    shadows = [
        Shadow(np.vstack([np.hstack([np.delete(np.eye(3), k, 0), np.zeros((2, 1))]), _FLAT]),
               np.delete(points, k, 1), weights)
        for k in range(3)
    ]  # fmt: skip
    cloud = observe(points, weights, None)
    found = []
    for t, _ in search(coordinates, shadows, _CANDIDATES):
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
    coordinates: Coordinates[PeonyPetal], scan: Scan, progress: Progress
) -> Iterator[tuple[str, PeonyPetal]]:
    """Petals to polish: one for each rib frequency that the cloud leaves open."""
    template, free = coordinates.template, coordinates.free
    some = scan.some(START_POINTS)
    points = scan.points[some]
    data = pad(points, scan.weights[some], None)
    progress("searching the outline")
    outline, complete = peony_start.fit_outline(template, free, points)
    polished = _smooth(coordinates, outline, data)
    if "b_y" in free and not complete:
        # Without its tip a petal has the outline of a shorter one: look at several lengths.
        rest = [name for name in free if name != "b_y"]
        for length in _LENGTHS:
            longer = with_values(template, {"b_y": length})
            outline, _ = peony_start.fit_outline(longer, rest, points)
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
    basins = ribs_beside(coordinates, smooth, ObservedCloud(data), polished.terms[0])
    yield from (with_ribs(smooth, basin) for basin in close(basins))


def ribs_beside(
    coordinates: Coordinates[Surface],
    smooth: Surface,
    cloud: ObservedCloud,
    term: AbstractTerm | None = None,
) -> list[RibBasin]:
    """Ribs that a cloud's distances to a petal without any speak for, the best first."""
    held = coordinates.holding(RIBS).around(smooth)
    return _explaining(held, cloud.data, cloud.look(smooth, term).uv)


def with_ribs(smooth: Surface, basin: RibBasin) -> tuple[str, Surface]:
    """A petal without ribs with those of a basin, and a label for it."""
    ribs = {"rib_frequency": basin.frequency, "rib_amplitude": basin.amplitude}
    return f"rib_frequency {basin.frequency:.2f}", with_values(smooth, ribs)


def _explaining(
    coordinates: Coordinates, data: Data, uv: Float[Array | np.ndarray, "n 2"]
) -> list[RibBasin]:
    """Ribs that explain the distances of points to the coordinates' petal, which is free to follow."""
    petal = coordinates.template
    seen = programs.survey(coordinates, data, coordinates.inverse(petal), uv)
    fixed = "rib_frequency" not in coordinates.free
    # Ribs rise along the petal's own z axis.
    up, unit = np.array([0.0, 0.0, 1.0]), 1.0
    if isinstance(petal, Posed):
        place = petal.placement
        up, unit = np.asarray(place.rotation)[:, 2], float(place.scale)
    return peony_start.rib_periodogram(
        float(value_at(petal, "rib_frequency")) if fixed else None,
        np.asarray(seen.distance) / unit,
        np.asarray(seen.normal) @ up,
        np.asarray(data.weights),
        np.asarray(uv),
        np.asarray(seen.slopes)[:, coordinates.active > 0],
    )


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
    heights = peony_start.Heights.of(outline, coordinates.free, data)
    if not heights.names:
        return outline, heights.uv
    weights = np.asarray(data.weights)
    amplitudes = peony_start.fit_amplitudes(heights.above, heights.basis, weights)
    return with_values(outline, dict(zip(heights.names, amplitudes, strict=True))), heights.uv


_FLAT = np.array([[0.0, 0.0, 0.0, 1.0]])  # the last row of an orthographic camera
_CANDIDATES = 12
_FOLLOWED = 2
_SAME = 0.3  # coordinates closer than this are one start
_ROUNDS = 30
_LENGTHS = (16.0, 21.0, 27.0, 35.0)
_TOLERANCE = 1e-2  # standard errors
