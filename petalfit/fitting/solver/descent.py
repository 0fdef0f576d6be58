"""Safeguarded descent for open surfaces, from starts that are only roughly right.

Far from the surface, a step that lowers the cost at fixed foot points may raise it once these are matched
again. Each step is therefore shortened by a prior around the point where it begins. The prior becomes
weaker while steps lower the cost, and stronger when one does not.
"""

from __future__ import annotations

import dataclasses
from typing import cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.likelihood import programs
from petalfit.fitting.likelihood.cloud import ObservedCloud, pad
from petalfit.fitting.likelihood.emptiness import ObservedEmptiness
from petalfit.fitting.solver.alternate import whiten
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import show
from petalfit.fitting.solver.solve import compiled_solve
from petalfit.residuals import AbstractTerm, Emptiness, TangentDistance
from petalfit.surfaces import AbstractSurface, cells

# Strength of the prior of a first step, usual and cautious: √(χ² per point) of a step by one unit.
HELD, HELD_BACK = 0.3, 3.0
_STUCK = 50.0  # the strongest prior that is tried
_FREE = 0.05  # a prior weaker than this hardly shortens a step
_JITTER = 0.01  # rise of the cost per point that is accepted, because foot points jump to and fro
# A descent ends if the best cost has fallen by less than _LEVEL per point in _PATIENCE rounds.
_PATIENCE, _LEVEL = 6, 0.003
_CELLS = 8  # per side of the domain, to count points in


@dataclasses.dataclass(frozen=True)
class Descent:
    """A safeguarded descent that brings a model of an open surface to a cloud.

    Attributes:
        cloud: The cloud.
        emptiness: The cost of those parts of the surface that have no points near them.
        count: The number of points of the cloud, without padding.
    """

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
    ) -> Descent:
        """The descent to points that belong to the surface with the probabilities `members`."""
        cloud = ObservedCloud(pad(points, weights * members, noise))
        return cls(cloud, ObservedEmptiness.of(points[members > 0.5]), len(points))

    def evaluate(
        self, coordinates: Coordinates, t: Float[np.ndarray, " p"], term: AbstractTerm | None
    ) -> Iterate:
        """Evaluates the cost at t as the solver counts it, with foot points and information there."""
        model = coordinates.model(t)
        cloud = self.cloud.match(model, term)
        here = programs.linearise(coordinates, cloud.data, t, cloud.uv)
        emptiness, nodes, excess = self.emptiness.around(model)
        weights = np.asarray(cloud.data.weights)
        total = float(np.sum(weights))
        square = float(np.sum(weights * np.asarray(here.distance) ** 2)) / total
        wrong = square + excess / self.count
        sigma = max(float(np.sqrt(square)), 1e-12)
        beyond = np.max(np.asarray(here.beyond), axis=-1) / sigma
        edge = float(np.sum(weights * -log_ndtr(-np.clip(beyond, -8.0, 1e3))))
        cost = 0.5 * total * np.log(wrong) + edge
        cost += _uniform_within_cells(model, cloud, nodes.blurred(sigma))
        cost = cost if np.isfinite(cost) else np.inf
        terms = (
            dataclasses.replace(cloud.with_noise(sigma), slides=np.asarray(0)),
            dataclasses.replace(emptiness, sigma=jnp.asarray(sigma)),
        )
        information = np.asarray(here.information)
        return Iterate(
            model,
            terms,
            0,
            np.inf,
            t,
            2 * cost,
            information=information,
            score_covariance=information,
        )

    def descend(
        self,
        coordinates: Coordinates,
        model: AbstractSurface,
        rounds: int,
        tolerance: float,
        held: float = HELD,
    ) -> Iterate:
        """Descends from a model to a minimum of the cost.

        Args:
            coordinates: The free parameters.
            model: The start.
            rounds: Upper bound of the number of steps.
            tolerance: Stop when a step changes √χ² by less than this.
            held: The strength of the prior of the first step.

        Returns:
            The best iterate. Its `moved` is in √χ², and its noise is in the term of the cloud.
        """
        here = self.evaluate(coordinates, coordinates.inverse(model), None)
        best, moved, number, since, level = here, np.inf, 0, 0, here.chi2
        for number in range(1, rounds + 1):
            if best.chi2 < level - 2 * _LEVEL * self.count:
                since, level = number, best.chi2
            if number - since > _PATIENCE:
                # Only jitter of foot points is left: the model cannot quite have the shape of the cloud.
                break
            there = self._step(coordinates, here, held)
            gain = here.chi2 - there.chi2
            # The cost jitters when points find nearer places on other parts of a rolled surface.
            if gain > -2 * _JITTER * self.count:
                moved = float(np.sqrt(abs(gain)))
                free, here, held = held < _FREE, there, max(held / 5, 1e-5)
                best = min(best, here, key=lambda end: end.chi2)
                show(here.model, here.terms[:1])
                if moved < tolerance and free:
                    break
            elif held < _STUCK:
                held *= 6
            else:
                break
        return dataclasses.replace(best, rounds=number, moved=moved)

    def _step(self, coordinates: Coordinates, here: Iterate, held: float) -> Iterate:
        t = cast(np.ndarray, here.t)
        root = held * np.sqrt(self.count) * np.ones(len(t))
        whitening = whiten(here.information + np.diag(root**2) + np.eye(len(t)))
        prior = Prior(t, root)
        state = compiled_solve(coordinates, here.terms, prior, t, whitening, 1, 1e-3)
        return self.evaluate(coordinates, np.asarray(state.t), here.terms[0])


def terms_of(end: Iterate) -> tuple[TangentDistance, Emptiness]:
    """The two terms of a descent's end: that of the cloud, and that of places without points."""
    cloud, emptiness = end.terms
    assert isinstance(cloud, TangentDistance)
    assert isinstance(emptiness, Emptiness)
    return cloud, emptiness


def _uniform_within_cells(
    model: AbstractSurface, cloud: TangentDistance, area: Float[np.ndarray, "n_u n_v"]
) -> float:
    """−Σ log density of the points, if their density is constant within each cell of the surface."""
    counts = np.zeros((_CELLS, _CELLS))
    cell = cells(model.domain, np.asarray(cloud.uv), _CELLS)
    np.add.at(counts, cell, np.asarray(cloud.data.weights))
    nodes = [np.minimum(np.arange(n) * _CELLS // n, _CELLS - 1) for n in area.shape]
    areas = np.zeros((_CELLS, _CELLS))
    np.add.at(areas, (nodes[0][:, None], nodes[1][None, :]), area)
    seen = counts > 0
    return float(np.sum(counts[seen] * np.log(np.maximum(areas[seen], 1e-300) / counts[seen])))
