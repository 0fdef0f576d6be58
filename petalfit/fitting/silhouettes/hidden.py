"""Allowance for what one outline cannot show: a blade that is taken to be flat may be bent."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from petalfit.components import parameters
from petalfit.fitting.coordinates import Coordinates, evenly_spread, with_values
from petalfit.fitting.inference.identifiability import typical_spread
from petalfit.fitting.likelihood.matching import Match, View
from petalfit.fitting.likelihood.pixels import slopes_of_outline
from petalfit.fitting.solver.iterate import Iterate
from petalfit.results import quantile
from petalfit.surfaces import AbstractSurface, Outline, outline, value_at

_DRAWS = 24
# The first step from the end to a draw, and the shortest. What of a draw cannot be followed in such steps
# does not count: the target has no such shape.
_STEP, _SHORTEST = 0.5, 0.1
_TRIES = 6  # of the shown parameters, in each step
_ENOUGH = 0.9  # tries end when the misfit falls by less than to this fraction
# A parameter that ends within this many standard deviations of a bound of its range has made up for what
# is hidden as far as it could: how far it would have moved is not known.
_AT_BOUND = 0.02
_FAR = 2.0  # the most that one try moves a parameter
_TEMPERED = 5.0  # kernels beyond which distances do not count more


def allowing_for_hidden(
    coordinates: Coordinates, view: View, end: Iterate, hidden: Sequence[str]
) -> Iterate:
    """The end of a fit to one silhouette, with parameters as uncertain as others that it hides are.

    Hidden parameters are drawn from their typical ranges, and for each draw the others are moved until
    the outline is followed again. The second moment of these moves is the uncertainty of the others. It
    has no first-order part where a blade is seen from the front, so that the slopes at the end do not
    tell it: a bend of 1.4 hides 40 % of a length.

    Args:
        coordinates: The free parameters.
        view: The silhouette.
        end: The end, with its information.
        hidden: Names of the parameters that it hides.
    """
    hidden = [name for name in coordinates.free if name in hidden]
    if not hidden or not end.is_finite:
        return end
    shown = np.array([name not in hidden for name in coordinates.free])
    half = np.array([np.ptp(parameters(end.model)[name].typical) for name in hidden]) / 2
    draws = half * (2 * evenly_spread(_DRAWS, len(hidden)) - 1)
    bent = _Bent.of(coordinates.around(end.model), view, hidden)
    moves = np.array([bent.followed(draw) for draw in draws])
    # As wide as the 95 % interval of one more draw.
    wider = (float(stdtrit(_DRAWS, 0.975)) / quantile(0.95)) ** 2 * (1 + 1 / _DRAWS)
    scores = moves @ end.information[shown]
    known = shown.astype(float)
    known[shown] = np.minimum(-bent.low, bent.high) > _AT_BOUND
    both = np.outer(known, known)
    return dataclasses.replace(
        end,
        information=end.information * both,
        score_covariance=(end.score_covariance + wider * scores.T @ scores / _DRAWS) * both,
    )


@dataclasses.dataclass(frozen=True)
class _Bent:
    """A fit whose hidden parameters move, while the others follow the silhouette.

    Moves of the others are measured in standard deviations of their typical ranges.

    Attributes:
        coordinates: The free parameters, around the model of the end.
        view: The silhouette.
        hidden: The hidden parameters and their values.
        shown: The others that are free and their values.
        spread: Standard deviations of the typical ranges of the latter, shape (q,).
        low: Their least moves, shape (q,).
        high: Their greatest moves, shape (q,).
        limit: The root mean squared distance in pixels up to which an outline is followed.
    """

    coordinates: Coordinates
    view: View
    hidden: dict[str, float]
    shown: dict[str, float]
    spread: Float[np.ndarray, " q"]
    low: Float[np.ndarray, " q"]
    high: Float[np.ndarray, " q"]
    limit: float

    @classmethod
    def of(cls, coordinates: Coordinates, view: View, names: Sequence[str]) -> _Bent:
        model = coordinates.template
        values = {name: float(value_at(model, name)) for name in coordinates.free}
        kept = [name not in names for name in values]
        shown = {name: value for name, value in values.items() if name not in names}
        hidden = {name: values[name] for name in names}
        spread = typical_spread(tuple(shown), parameters(model))
        here = np.array(list(shown.values()))
        middle, half = coordinates.middle[kept], coordinates.half[kept]
        low, high = (middle - half - here) / spread, (middle + half - here) / spread
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        bent = cls(coordinates, view, hidden, shown, spread, low, high, view.kernel)
        still = bent.at(np.zeros(len(shown)), np.zeros(len(hidden)))
        return dataclasses.replace(bent, limit=max(view.kernel, 2 * still.misfit))

    def at(self, moved: np.ndarray, change: np.ndarray) -> _Place:
        """Matches the silhouette with the model whose shown and hidden parameters are changed."""
        shown, hidden = np.array(list(self.shown.values())), np.array(list(self.hidden.values()))
        values = np.concatenate([shown + self.spread * moved, hidden + change])
        names = (*self.shown, *self.hidden)
        model = with_values(self.coordinates.template, dict(zip(names, values, strict=True)))
        seen = outline(model, self.view.contour.camera)
        match = self.view.matched(seen)
        distance = np.minimum(np.abs(match.distance), _TEMPERED * self.view.kernel)
        misfit = float(np.sqrt(np.average(distance**2, weights=match.length)))
        return _Place(moved, model, seen, match, misfit)

    def followed(self, change: np.ndarray) -> Float[np.ndarray, " q"]:
        """How far the shown parameters move to follow a change, or as much of it as can be followed."""
        reached, moved, step = 0.0, np.zeros(len(self.shown)), _STEP
        while reached < 1 and step >= _SHORTEST:
            part = min(1.0, reached + step)
            # Seen from the front, moves grow with the square of a change.
            further = min((part / reached) ** 2, 4.0) if reached else 1.0
            place = self.nearest(further * moved, part * change)
            if place.misfit < self.limit:
                reached, moved = part, place.moved
            else:
                step /= 2
        return self.spread * moved

    def nearest(self, moved: np.ndarray, change: np.ndarray) -> _Place:
        """Moves the shown parameters on until the outline follows the silhouette."""
        place, damping = self.at(np.clip(moved, self.low, self.high), change), 0.0
        system = self.system(place)
        for _ in range(_TRIES):
            trial = np.clip(place.moved + _step(*system, damping), self.low, self.high)
            other = self.at(trial, change)
            if other.misfit >= place.misfit:
                damping = 4 * damping + 4
                continue
            small = other.misfit > _ENOUGH * place.misfit
            place, damping = other, damping / 4
            if small:
                break
            system = self.system(place)
        return place

    def system(self, place: _Place) -> tuple[np.ndarray, np.ndarray]:
        """The matrix of the normal equations of a step, and the gradient; a weak prior holds the end."""
        match, seen = place.match, place.seen
        around = self.coordinates.around(place.model)
        t = around.inverse(place.model)
        slopes = slopes_of_outline(around, t, self.view.contour, seen) / around.slopes(t)
        kept = [name in self.shown for name in around.free]
        rows = match.slopes(seen, self.spread * slopes[:, kept])
        tempered = 1 + (match.distance / (_TEMPERED * self.view.kernel)) ** 2
        weights = match.length / (2 * tempered)
        return rows.T @ (weights[:, None] * rows), rows.T @ (weights * match.distance) + place.moved


class _Place(NamedTuple):
    """A model on the way from the end to a change.

    Attributes:
        moved: The moves of its shown parameters, shape (q,).
        model: The model.
        seen: Its outline.
        match: The match of that with the silhouette.
        misfit: The root mean squared distance in pixels, with large ones tempered.
    """

    moved: Float[np.ndarray, " q"]
    model: AbstractSurface
    seen: Outline
    match: Match
    misfit: float


def _step(normal: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """A step of Levenberg and Marquardt's."""
    held = np.eye(len(gradient)) + damping * np.diag(np.diag(normal))
    step = -np.linalg.solve(normal + held, gradient)
    return step * min(1.0, _FAR / np.abs(step).max())
