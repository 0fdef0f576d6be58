"""Fits of sheets in a pose that may be unknown, from starts that are only roughly right.

Each round's step is held back by a prior around where it begins, which is let go while rounds help and
tightened when one does not: far from the surface a step that helps with foot points held may hurt.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.special import log_ndtr

from petalfit.compilation import stage
from petalfit.components import BladePetal, Posed
from petalfit.fitting import programs
from petalfit.fitting.blade_start import BladeStart, blade_starts
from petalfit.fitting.canonical import Canonical
from petalfit.fitting.cloud import ObservedCloud, pad, with_all_points
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.live import show
from petalfit.fitting.patches import Patches, cells
from petalfit.fitting.rounds import (
    AbstractObserved,
    Account,
    Polished,
    Progress,
    Seen,
    Settled,
    finish,
    whiten,
)
from petalfit.fitting.scan import Scan
from petalfit.fitting.solve import Prior
from petalfit.observations import PointCloud
from petalfit.residuals import AbstractTerm, Emptiness, TangentDistance
from petalfit.surfaces import AbstractSurface

# Points that a start is found with, and that rough steps are taken on.
_SOME = 1536
_ROUGHLY = 768
_FOLLOWED = 2
# Left for later: what is redundant while the rest is rough.
_LATER = ("tip_roll", "margin_curl", "keel", "tip_edge", "base_edge", "skew")
_ROUGH, _FINE = 10, 30  # rounds
# A start whose χ² is worse than the best's by more than this after rough rounds is not followed.
_HOPELESS = 0.1  # of the number of points
_SLACK = 1.5  # spacings of the points
_SETTLED = 0.3  # √χ² of a round's gain
_STUCK = 50.0
_HELD, _HELD_BACK = 0.3, 3.0  # prior of a step, in √χ² of one unit for each point
_FAR = 0.012  # of the extent: a blade that is so far from its points may be in the wrong place
_JITTER = 0.01  # of the number of points, in the cost: foot points that jump to and fro
# Rounds in which the best cost does not fall by so large a part of the points end a descent.
_PATIENCE, _LEVEL = 6, 0.003
_CELLS = 8  # per side, that points are counted in
_CLEARINGS, _AGAIN = 3, 6
_UNCHANGED = 0.002  # of the points
_FREE = 0.05  # a step held back by less than this is as long as it wants to be


def spacing(tree: KDTree) -> float:
    """The side of the square that a point of a sheet has to itself, as a rule."""
    # Six neighbours lie in a disc of six and a half points' area.
    sixth = np.median(np.asarray(tree.query(tree.data, 7)[0])[:, 6])
    return float(sixth * np.sqrt(np.pi / 6.5))


@dataclasses.dataclass(frozen=True)
class ObservedEmptiness(AbstractObserved):
    """Where no points are.

    Attributes:
        tree: Of the points.
        slack: How far from a point a covered surface may be.
    """

    tree: KDTree
    slack: float

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"]) -> ObservedEmptiness:
        tree = KDTree(points)
        return cls(tree, _SLACK * spacing(tree))

    def look(self, model: AbstractSurface, term: AbstractTerm | None) -> Emptiness:
        return self.around(model)[0]

    def around(self, model: AbstractSurface) -> tuple[Emptiness, Patches, float]:
        """The term there, the places that it looks at, and twice its cost at a noise of 1."""
        patches = Patches.of(model)
        gap, nearest = map(np.asarray, self.tree.query(patches.places))
        weights = self.tree.n * patches.area.ravel() / patches.area.sum()
        term = Emptiness(
            uv=jnp.asarray(patches.uv),
            nearest=jnp.asarray(self.tree.data[nearest]),
            weights=jnp.asarray(weights),
            slack=jnp.asarray(self.slack),
            sigma=jnp.asarray(self.slack),
        )
        return term, patches, float(np.sum(weights * np.maximum(gap - self.slack, 0.0) ** 2))

    def misfit(self, model: AbstractSurface) -> float:
        return 0.0

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        return np.zeros((len(t), len(t))), float(term.sigma)

    def account(self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm) -> Account:
        nothing = np.zeros((len(t), len(t)))
        return Account(term, nothing, np.zeros(len(t)), nothing)

    def seen(self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm) -> list[Seen]:
        return []


class _Place(NamedTuple):
    """Where a descent stands.

    Attributes:
        t: Coordinates.
        cloud, emptiness: Terms with foot points there.
        information: Of the cloud, at the noise `sigma`.
        sigma: Root mean square of the normal distances.
        cost: Negative logarithm of the likelihood, but for a constant.
    """

    t: Float[np.ndarray, " p"]
    cloud: TangentDistance
    emptiness: Emptiness
    information: Float[np.ndarray, "p p"]
    sigma: float
    cost: float


@dataclasses.dataclass(frozen=True)
class Sheet:
    """A cloud of a sheet, and the steps that bring a surface to it."""

    cloud: ObservedCloud
    emptiness: ObservedEmptiness
    count: int

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "n 3"],
        weights: Float[np.ndarray, " n"],
        noise: float | None,
        members: Float[np.ndarray, " n"],
    ) -> Sheet:
        """Of points, each with the probability that it belongs to the sheet."""
        cloud = ObservedCloud(pad(points, weights * members, noise))
        return cls(cloud, ObservedEmptiness.of(points[members > 0.5]), len(points))

    def place(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm | None
    ) -> _Place:
        """What is wrong with the surface there, as `solve` counts it."""
        model = coordinates.model(t)
        cloud = self.cloud.look(model, term)
        survey = programs.survey(coordinates, cloud.data, t, cloud.uv)
        emptiness, patches, excess = self.emptiness.around(model)
        weights = np.asarray(cloud.data.weights)
        total = float(np.sum(weights))
        square = float(np.sum(weights * np.asarray(survey.distance) ** 2)) / total
        wrong = square + excess / self.count
        sigma = max(float(np.sqrt(square)), 1e-12)
        beyond = np.max(np.asarray(survey.beyond), axis=-1) / sigma
        edge = float(np.sum(weights * -log_ndtr(-np.clip(beyond, -8.0, 1e3))))
        cost = 0.5 * total * np.log(wrong) + edge
        cost += _spread_out(model, cloud, patches.blurred(sigma))
        cost = cost if np.isfinite(cost) else np.inf
        return _Place(t, cloud, emptiness, np.asarray(survey.information), sigma, cost)

    def descend(
        self,
        coordinates: Coordinates,
        model: AbstractSurface,
        rounds: int,
        tolerance: float,
        held: float = _HELD,
    ) -> tuple[_Place, int, float]:
        """Steps from a model; how many there were, and how much the last ones changed, in √χ².

        `held` is how strongly the first step is held back.
        """
        here = self.place(coordinates, coordinates.inverse(model), None)
        best, moved, number, since, level = here, np.inf, 0, 0, here.cost
        for number in range(1, rounds + 1):
            if best.cost < level - _LEVEL * self.count:
                since, level = number, best.cost
            if number - since > _PATIENCE:
                # All that is left is the jitter of foot points on a shape that is not quite its own.
                return best, number, min(moved, tolerance)
            there = self._step(coordinates, here, held)
            gain = here.cost - there.cost
            # Points that find nearer places on other parts of a rolled surface make costs jitter.
            if gain > -_JITTER * self.count:
                moved = float(np.sqrt(2 * abs(gain)))
                free, here, held = held < _FREE, there, max(held / 5, 1e-5)
                best = min(best, here, key=lambda place: place.cost)
                show(coordinates.model(here.t), [here.cloud])
                if moved < tolerance and free:
                    break
            elif held < _STUCK:
                held *= 6
            else:
                break
        return best, number, moved

    def _step(self, coordinates: Coordinates, here: _Place, held: float) -> _Place:
        root = held * np.sqrt(self.count) * np.ones(len(here.t))
        terms = (
            dataclasses.replace(here.cloud.with_noise(here.sigma), slides=np.asarray(0)),
            dataclasses.replace(here.emptiness, sigma=jnp.asarray(here.sigma)),
        )
        whitening = whiten(here.information + np.diag(root**2) + np.eye(len(here.t)))
        prior = Prior(here.t, root)
        state = programs.solve(coordinates, terms, prior, here.t, whitening, 1, 1e-3)
        return self.place(coordinates, np.asarray(state.t), here.cloud)


def _spread_out(
    model: AbstractSurface, cloud: TangentDistance, area: Float[np.ndarray, "n_u n_v"]
) -> float:
    """−Σ log density of points that are spread evenly within each of some cells of the surface."""
    counts = np.zeros((_CELLS, _CELLS))
    cell = cells(model.domain, np.asarray(cloud.uv), _CELLS)
    np.add.at(counts, cell, np.asarray(cloud.data.weights))
    nodes = [np.minimum(np.arange(n) * _CELLS // n, _CELLS - 1) for n in area.shape]
    areas = np.zeros((_CELLS, _CELLS))
    np.add.at(areas, (nodes[0][:, None], nodes[1][None, :]), area)
    seen = counts > 0
    return float(np.sum(counts[seen] * np.log(np.maximum(areas[seen], 1e-300) / counts[seen])))


def fit_sheet(
    template: BladePetal,
    free: tuple[str, ...],
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    *,
    pose: str,
    loss: str,
    noise: float | None,
    from_template: bool,
    seed: int,
    progress: Progress,
) -> tuple[AbstractSurface, tuple[str, ...], list[Settled]]:
    """Fit a blade in a known or an unknown pose.

    Args:
        template: Values of the fixed parameters; of all parameters if `from_template`.
        free: Names of the parameters to fit.
        points: Shape (n, 3), finite.
        weights: Shape (n,), not all zero.
        pose: "known", "rigid" or "similarity".
        loss: "linear" or "robust".
        noise: σ, or None to estimate it.
        from_template: Start at the template instead of searching; with a known pose only.
        seed: Of the choice of points for the start.
        progress: Called with a line of text when a stage begins.

    Returns:
        The template, perhaps posed; the names of all that is free; and what each start reached, the best
        first. Call it inside `jax.enable_x64(True)`.
    """
    used = weights > 0
    frame = Canonical.of(points[used], pose)
    order = frame.order(points[used], seed)
    own, mass = frame.into(points[used])[order], weights[used][order]
    noise = None if noise is None else noise / frame.unit
    scan = Scan.of(own, mass, np.arange(len(own)), noise, loss)
    sheets, masses = own[scan.likely], mass[scan.likely]
    if pose == "similarity":
        free = tuple(name for name in free if name != "length")
    names = (*free, *Posed.free_in(pose))
    starts: list[tuple[str, AbstractSurface]] = [("given", template)]
    found: dict[str, BladeStart] = {}
    if not from_template:
        progress("laying it flat")
        ways = blade_starts(template, free, sheets[:_SOME], pose != "known")[:_FOLLOWED]
        found = {start.label: start for start in ways}
        starts = [(label, _started(start, pose)) for label, start in found.items()]
    some = masses[:_ROUGHLY]
    rough = Sheet.of(sheets[:_ROUGHLY], some, noise, np.ones(len(some)))
    ends = []
    for label, model in starts:
        progress(f"rough steps from {label}")
        coordinates = Coordinates.of(model, names)
        place, _, _ = rough.descend(coordinates.holding(_LATER), model, _ROUGH, 3.0)
        ends.append((place.cost, label, coordinates.model(place.t)))
    ends.sort(key=lambda end: end[0])
    settled = []
    for cost, label, model in ends:
        if cost - ends[0][0] < _HOPELESS * len(rough.cloud.data.points):
            progress(f"polishing from {label}")
            coordinates = Coordinates.of(model, names)
            with stage("polishing"):
                settled.append(_settle(coordinates, label, model, scan))
    settled.sort(key=lambda end: end.chi2)
    if found:
        first = found[settled[0].label]
        settled = [
            dataclasses.replace(end, label=found[end.label].beside(first)) for end in settled
        ]
    ends = [_in_target(end, names, frame, order) for end in settled]
    cloud = PointCloud(points, weights=weights)
    best = with_all_points(Coordinates.of(ends[0].model, names), ends[0], 0, cloud)
    return best.model, names, [best, *ends[1:]]


class _Descended(NamedTuple):
    """Where a descent ended.

    Attributes:
        sheet: With the weights of its points there.
        place: There.
        rounds: How many there were.
        moved: How much the last one changed, in √χ².
        log_likelihood: Of the points among clutter; None if all belong to the sheet.
    """

    sheet: Sheet
    place: _Place
    rounds: int
    moved: float
    log_likelihood: float | None


def _descended(
    coordinates: Coordinates,
    model: AbstractSurface,
    scan: Scan,
    rounds: int,
    held: float = _HELD,
) -> _Descended:
    """Steps from a model; among clutter some more whenever other points belong to the sheet."""
    points, weights, members = scan.points, scan.weights, scan.likely.astype(float)
    sheet = Sheet.of(points, weights, scan.noise, members)
    place, number, moved = sheet.descend(coordinates, model, rounds, _SETTLED, held)
    if scan.clutter is None:
        return _Descended(sheet, place, number, moved, None)
    clearings = 0
    while True:
        model, clearings = coordinates.model(place.t), clearings + 1
        beside = sheet.cloud.beside(coordinates, coordinates.inverse(model), place.cloud)
        found = scan.clutter.mixture(model, *beside, weights, scan.noise)
        changed, members = float(np.mean(np.abs(found.members - members))), found.members
        sheet = Sheet.of(points, weights, scan.noise, members)
        place, more, moved = sheet.descend(coordinates, model, _AGAIN, _SETTLED)
        number += more
        if changed < _UNCHANGED or clearings == _CLEARINGS:
            return _Descended(sheet, place, number, moved, found.log_likelihood)


def _settle(coordinates: Coordinates, label: str, model: AbstractSurface, scan: Scan) -> Settled:
    """All the way from a start, on ever more points."""
    number = 0
    if len(scan.points) > 2 * _SOME:
        near = _descended(coordinates, model, scan.first(_SOME), _FINE)
        model, number = coordinates.model(near.place.t), near.rounds
    end = _descended(coordinates, model, scan, _FINE)
    if end.place.sigma > _FAR * np.linalg.norm(np.ptp(scan.points, axis=0)):
        # Shorter steps may lead around what this one fell into.
        other = _descended(coordinates, model, scan, _FINE, _HELD_BACK)
        end = min(end, other, key=lambda end: end.place.cost)
    settled = _finish(end.sheet, coordinates, label, end.place, number + end.rounds, end.moved)
    if end.log_likelihood is None:
        return settled
    return dataclasses.replace(settled, chi2=-2 * end.log_likelihood)


def _started(start: BladeStart, pose: str) -> AbstractSurface:
    """A start as a surface, its pose around it unless it is known."""
    blade = start.blade
    if pose != "similarity":
        blade = with_values(blade, {"length": blade.length * start.scale})
    if pose == "known":
        return blade
    unit = start.scale if pose == "similarity" else 1.0
    return Posed(blade, start.rotation, start.translation, unit)


def _in_target(
    end: Settled, names: tuple[str, ...], frame: Canonical, order: np.ndarray
) -> Settled:
    """An end in the target's frame and unit, its points in the target's order."""
    back = np.argsort(order)
    (seen,) = end.seen
    assert seen.uv is not None
    seen = seen._replace(distance=seen.distance[back], weights=seen.weights[back], uv=seen.uv[back])
    end, model = dataclasses.replace(end, seen=(frame.measured(seen),)), end.model
    if not isinstance(model, Posed):
        return end
    model = frame.back(model)
    blade = model.surface
    assert isinstance(blade, BladePetal)
    if float(blade.cup_mid) < 0:
        # The same blade by other numbers: the side that it is hollow on is the upper one.
        over = programs.numbers(blade.turned_over())
        rotation = np.asarray(model.rotation) @ np.diag([-1.0, 1.0, -1.0])
        model = Posed(over, rotation, model.origin, model.unit)
        end = _turned_over(end, names)
    return dataclasses.replace(end, model=model)


def _turned_over(end: Settled, names: tuple[str, ...]) -> Settled:
    """What was seen beside a blade, and its information, in the numbers of the blade turned over.

    Those of a pose, which is a nuisance to them, may keep their signs.
    """
    signs = np.where(np.isin(names, BladePetal.sided), -1.0, 1.0)
    both = np.outer(signs, signs)
    (seen,) = end.seen
    assert seen.uv is not None
    seen = seen._replace(distance=-seen.distance, uv=seen.uv * [-1.0, 1.0])
    return dataclasses.replace(
        end, information=end.information * both, spread=end.spread * both, seen=(seen,)
    )


def _finish(
    sheet: Sheet, coordinates: Coordinates, label: str, place: _Place, rounds: int, moved: float
) -> Settled:
    """The end of a descent, with its information."""
    cloud = place.cloud.with_noise(place.sigma)
    polished = Polished(coordinates.model(place.t), (cloud,), rounds, moved)
    end = finish(coordinates, label, [sheet.cloud], polished)
    (seen,) = end.seen
    assert seen.uv is not None
    n = sheet.count
    seen = seen._replace(distance=seen.distance[:n], weights=seen.weights[:n], uv=seen.uv[:n])
    return dataclasses.replace(end, seen=(seen,))
