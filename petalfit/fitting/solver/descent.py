"""Descent to a stationary point of the likelihood of a sheet, inside the bounds of its parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from petalfit.components import Posed, parameters
from petalfit.fitting.coordinates import Box, Prior
from petalfit.fitting.likelihood.foot_points import signed_distance
from petalfit.fitting.likelihood.observed import Residuals
from petalfit.fitting.likelihood.sheet import NUISANCES, SEARCH, STEPS, Sheet
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import is_looked_on, show
from petalfit.residuals import Data, TangentDistance
from petalfit.surfaces import AbstractSurface

# The inverse standard deviation of the prior on a model's own parameters, in units of the spread of the
# typical range. It gives a valley one bottom, and moves a parameter whose standard error is below 0.3
# spreads by less than a tenth of that.
ALWAYS = 1 / 3
TOLERANCE = 0.2  # standard errors
_LOOK_AGAIN = 12  # steps, after which places are searched for on the whole surface
_JITTER = 1e-4  # rise of the cost that is accepted, because a nearest segment may change
_FIRST, _LEAST, _MOST = 300.0, 1e-3, 1e10  # damping, per squared spread
# log τ/σ, the blur of the edges relative to the noise: its least, first and greatest value.
_BLURS = (0.0, 0.1, 1.4)
_QUIETER = 1.5  # the greatest change of log σ in a step
_FOLLOWED = 0.1  # places follow a step by at most this part of the domain
# A descent is not followed further if its cost is higher than that of another end by more than the first
# number, and by more than the second one times what it gained since the last search.
_HOPELESS, _LAGGING = 5.0, 1.0
_FLOOR = 1e-9  # the least noise, relative to the extent


@dataclasses.dataclass(frozen=True, eq=False)
class DescentPoint:
    """Where a descent stands.

    Attributes:
        z: Coordinates of the free parameters, log σ and log τ/σ.
        places: The places of the points, with those of the padding.
        following: Their derivatives by z.
        cost: The cost with the prior, at the problem's temperature.
        gradient: Its derivative.
        information: Its information.
        each: The cost −log L of every point, without what is common to all.
    """

    z: Float[np.ndarray, " q"]
    places: Float[np.ndarray, "n 2"]
    following: Float[np.ndarray, "n 2 q"]
    cost: float
    gradient: Float[np.ndarray, " q"]
    information: Float[np.ndarray, "q q"]
    each: Float[np.ndarray, " n"]

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.cost) and np.isfinite(self.gradient).all())


@dataclasses.dataclass(frozen=True, eq=False)
class Descent:
    """The problem of a descent: the likelihood of a cloud with the prior, inside a box.

    Attributes:
        box: The free parameters.
        sheet: The likelihood.
        prior: The prior on the parameters.
        temperature: T, by which −log L is divided.
        low: Lower bounds of z.
        high: Upper bounds of z.
    """

    box: Box
    sheet: Sheet
    prior: Prior
    temperature: float
    low: Float[np.ndarray, " q"]
    high: Float[np.ndarray, " q"]

    @classmethod
    def of(
        cls,
        model: AbstractSurface,
        free: tuple[str, ...],
        sheet: Sheet,
        noise: float | None = None,
        temperature: float = 1.0,
    ) -> Descent:
        """The problem of a cloud.

        Args:
            model: A model; parameters that are not free keep its values.
            free: Names of the free parameters.
            sheet: The likelihood of the cloud.
            noise: σ, or None to estimate it.
            temperature: T, by which −log L is divided before the prior is added.
        """
        box = Box.of(model, free)
        extent = float(np.linalg.norm(np.ptp(sheet.points, axis=0)))
        sigmas = (_FLOOR * extent, extent) if noise is None else (noise, noise)
        low = np.concatenate([box.low, [np.log(sigmas[0]), _BLURS[0]]])
        high = np.concatenate([box.high, [np.log(sigmas[1]), _BLURS[2]]])
        return cls(box, sheet, always(box), temperature, low, high)

    def start(self, model: AbstractSurface) -> DescentPoint:
        """Where the descent begins: the model, moved inside its bounds, and the noise beside it."""
        box = self.box
        # A start on a bound could not leave it where its derivatives vanish.
        inside = 1e-3 * (box.high - box.low)
        own = np.clip(box.place(model), box.low + inside, box.high - inside)
        model = box.model(own)
        uv = self.sheet.nearest(model)
        z = np.concatenate([own, [np.log(self.sheet.spread(model, uv)), _BLURS[1]]])
        z = np.clip(z, self.low, self.high)
        return self._evaluate(z, uv, SEARCH)

    def evaluate_anywhere(self, z: Float[np.ndarray, " q"]) -> DescentPoint:
        """The cost at z, with places on the whole surface."""
        return self._evaluate(z, self.sheet.nearest(self.box.model(z[:-NUISANCES])), SEARCH)

    def search(self, here: DescentPoint) -> DescentPoint:
        """The same z, after a search for places that are likelier than the known ones."""
        found = self.evaluate_anywhere(here.z)
        likelier = found.each < here.each
        if not np.any(likelier & (self.sheet.padded_weights > 0)):
            return here
        return self.evaluate(here.z, np.where(likelier[:, None], found.places, here.places))

    def evaluate(
        self, z: Float[np.ndarray, " q"], places: Float[np.ndarray, "n 2"]
    ) -> DescentPoint:
        """The cost at z, with places near the given ones."""
        return self._evaluate(z, places, STEPS)

    def _evaluate(
        self, z: Float[np.ndarray, " q"], places: Float[np.ndarray, "n 2"], steps: int
    ) -> DescentPoint:
        """The cost at z with the prior, after some Newton steps of the places."""
        found = self.sheet.cost(self.box, z, places, steps)
        nothing = np.zeros(NUISANCES)
        root = np.append(self.prior.root, nothing)
        away = root * (z - np.append(self.prior.centre, nothing))
        return DescentPoint(
            z,
            np.asarray(found.places),
            np.asarray(found.following),
            float(found.cost) / self.temperature + 0.5 * float(away @ away),
            np.asarray(found.gradient) / self.temperature + root * away,
            np.asarray(found.information) / self.temperature + np.diag(root**2),
            np.asarray(found.each),
        )

    def step(self, here: DescentPoint, damping: float) -> Float[np.ndarray, " q"]:
        """The step to the least value of the damped quadratic model inside the box."""
        low, high = self.low - here.z, self.high - here.z
        low[-2], high[-2] = max(low[-2], -_QUIETER), min(high[-2], _QUIETER)
        return _least(here.gradient, here.information + damping * np.eye(len(here.z)), low, high)

    def left(self, here: DescentPoint) -> float:
        """The length of the undamped step, in standard errors."""
        step = self.step(here, 0.0)
        return float(np.sqrt(max(step @ here.information @ step, 0.0)))


@dataclasses.dataclass(frozen=True, eq=False)
class DescentEnd:
    """The end of a descent.

    Attributes:
        problem: The problem.
        point: Where the descent ended.
        rounds: The number of evaluations.
        moved: The length of the Gauss-Newton step that is left, in standard errors.
        damping: The damping with which the descent goes on.
        label: The label of the start.
    """

    problem: Descent
    point: DescentPoint
    rounds: int
    moved: float
    damping: float
    label: str

    @property
    def model(self) -> AbstractSurface:
        return self.problem.box.model(self.point.z[:-NUISANCES])

    @property
    def chi2(self) -> float:
        """−2 log L, with the prior at the problem's temperature."""
        return 2 * self.problem.temperature * self.point.cost

    @property
    def sigma(self) -> float:
        return float(np.exp(self.point.z[-2]))

    @property
    def blur(self) -> float:
        """The blur τ of the edges."""
        return float(np.exp(np.sum(self.point.z[-NUISANCES:])))

    def away(self, other: DescentEnd) -> float:
        """How far another place lies from this one, in standard errors of this one."""
        step = other.point.z - self.point.z
        return float(np.sqrt(max(step @ self.point.information @ step, 0.0)))

    def with_cloud(self, sheet: Sheet, temperature: float) -> DescentEnd:
        """The same place before another cloud, from which a descent can go on."""
        problem = dataclasses.replace(self.problem, sheet=sheet, temperature=temperature)
        point = problem.evaluate_anywhere(self.point.z)
        return dataclasses.replace(self, problem=problem, point=point, moved=problem.left(point))

    def end(self) -> Iterate:
        """The end in the form of other solvers, with foot points and residuals."""
        problem, here, model = self.problem, self.point, self.model
        distance, beyond, uv = problem.sheet.beside(model, here.places)
        sheet = problem.sheet.whole
        residuals = Residuals(
            signed_distance(distance, beyond), sheet.weights, self.sigma, "length", self.chi2, uv
        )
        roots = np.append(problem.prior.root, np.zeros(NUISANCES))
        information = here.information - np.diag(roots**2)
        information = problem.temperature * _without_nuisances(information)
        slopes = np.asarray(problem.box.slopes(here.z[:-NUISANCES]))
        information = information / np.outer(slopes, slopes)
        return Iterate(
            model,
            (_term(sheet, uv, self.sigma),),
            self.rounds,
            self.moved,
            None,
            self.chi2,
            self.label,
            information,
            information,
            (residuals,),
        )


def begun(problem: Descent, model: AbstractSurface, label: str = "") -> DescentEnd:
    """The start of a descent."""
    point = problem.start(model)
    return DescentEnd(problem, point, 1, problem.left(point), _FIRST, label)


def descend(
    start: DescentEnd, rounds: int, tolerance: float = TOLERANCE, least: float = np.inf
) -> DescentEnd:
    """Follows the likelihood of a sheet from a start to its stationary point.

    The method is Gauss-Newton with Levenberg's damping: directions that the data hardly determine take
    short steps, the others whole ones. A parameter at a bound is held there while the cost would push it
    out.

    Args:
        start: The start, or the end of another descent.
        rounds: Upper bound of the number of evaluations.
        tolerance: The length of the step, in standard errors, below which the descent ends.
        least: The χ² of another end. A descent that is far above it, and gains little, stops.
    """
    problem, here, damping, moved = start.problem, start.point, start.damping, start.moved
    factor, number, since, before = 2.0, 0, 0, start.point.cost
    while number < rounds and (moved > tolerance or since > 0):
        number += 1
        if moved <= tolerance or since == _LOOK_AGAIN:
            missing = here.cost - least / (2 * problem.temperature)
            if missing > max(_HOPELESS, _LAGGING * (before - here.cost)):
                break
            before = here.cost
            here, since = problem.search(here), 0
            moved = problem.left(here)
            continue
        step = problem.step(here, damping)
        promised = -float(here.gradient @ step + 0.5 * step @ here.information @ step)
        there = problem.evaluate(here.z + step, _followed(problem.box.template, here, step))
        gain, since = here.cost - there.cost, since + 1
        if there.is_finite and gain > -_JITTER:
            share = gain / promised if promised > 10 * _JITTER else 1.0
            damping = max(damping * max(0.2, 1 - (2 * share - 1) ** 3), _LEAST)
            here, factor, moved = there, 2.0, problem.left(there)
            if is_looked_on():
                end = DescentEnd(problem, here, number, moved, damping, start.label)
                # Places in the plane are good enough for a picture.
                count = len(problem.sheet.points)
                show(end.model, [_term(problem.sheet, here.places[:count], end.sigma)])
        else:
            damping, factor = damping * factor, min(2 * factor, 32.0)
            if damping > _MOST:
                break
    return DescentEnd(problem, here, start.rounds + number, moved, damping, start.label)


def _followed(
    model: AbstractSurface, here: DescentPoint, step: Float[np.ndarray, " q"]
) -> Float[np.ndarray, "n 2"]:
    """The places to which a step of z moves those of the points, to first order."""
    low, high = (np.array(side) for side in zip(*model.domain, strict=True))
    most = _FOLLOWED * (high - low)
    return here.places + np.clip(here.following @ step, -most, most)


def always(box: Box) -> Prior:
    """The weak prior on a model's own parameters that every fit of a sheet has."""
    own = parameters(box.template.surface if isinstance(box.template, Posed) else box.template)
    return Prior(box.middle(), np.array([ALWAYS if name in own else 0.0 for name in box.free]))


def _least(
    gradient: Float[np.ndarray, " q"],
    curvature: Float[np.ndarray, "q q"],
    low: Float[np.ndarray, " q"],
    high: Float[np.ndarray, " q"],
) -> Float[np.ndarray, " q"]:
    """The step to the least value of a convex quadratic model inside a box, by an active set."""
    scale = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    slope, matrix = gradient * scale, curvature * np.outer(scale, scale)
    matrix = matrix + 1e-12 * np.eye(len(scale))
    low, high = np.minimum(low / scale, 0.0), np.maximum(high / scale, 0.0)
    step, held = np.zeros(len(scale)), np.zeros(len(scale), bool)
    for _ in range(4 * len(scale)):
        free, goal = ~held, step.copy()
        force = slope[free] + matrix[np.ix_(free, held)] @ step[held]
        goal[free] = -np.linalg.solve(matrix[np.ix_(free, free)], force)
        over = np.where(goal > high, high - step, np.where(goal < low, low - step, np.inf))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(np.isfinite(over), over / (goal - step), 1.0)
        share = np.where(free, share, 1.0)
        first = int(np.argmin(share))
        if share[first] < 1.0:
            step = step + max(share[first], 0.0) * (goal - step)
            step[first], held[first] = np.clip(goal[first], low[first], high[first]), True
            continue
        step = goal
        pull = slope + matrix @ step
        wrong = np.where(held, np.where(step <= low, -pull, pull), -np.inf)
        if np.max(wrong) <= 1e-9 * np.max(np.abs(slope), initial=1e-300):
            break
        held[int(np.argmax(wrong))] = False
    return np.clip(step, low, high) * scale


def _term(sheet: Sheet, uv: Float[np.ndarray, "n 2"], sigma: float) -> TangentDistance:
    data = Data.of(sheet.points, sheet.weights, None)
    return TangentDistance(data=data, uv=uv, sigma=sigma)


def _without_nuisances(information: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "p p"]:
    """The information of the parameters, with log σ and log τ/σ estimated beside them."""
    own, across = information[:-NUISANCES, :-NUISANCES], information[:-NUISANCES, -NUISANCES:]
    nuisances = information[-NUISANCES:, -NUISANCES:] + 1e-9 * np.eye(NUISANCES)
    return own - across @ np.linalg.solve(nuisances, across.T)
