"""Allowance for what one outline cannot show: a blade that is taken to be flat may be bent."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from petalfit.components import parameters
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.inference.identifiability import typical_spread
from petalfit.fitting.likelihood.matching import View
from petalfit.fitting.likelihood.pixels import scores_of_outlines
from petalfit.fitting.solver.iterate import Iterate
from petalfit.surfaces import value_at

_DRAWS = 48


def allowing_for_hidden(
    coordinates: Coordinates, view: View, end: Iterate, hidden: Sequence[str]
) -> Iterate:
    """The end of a fit to one silhouette, with parameters as uncertain as others that it hides are.

    Models whose hidden parameters have random values of their typical ranges have other outlines. To
    follow these with the hidden parameters held, the others would have to move, and that is their
    uncertainty. It has no first-order part where a blade is seen from the front, so that the slopes at
    the end do not tell it.

    Args:
        coordinates: The free parameters.
        view: The silhouette.
        end: The end, with its information.
        hidden: Names of the parameters that it hides.
    """
    hidden = [name for name in coordinates.free if name in hidden]
    if not hidden or not end.is_finite:
        return end
    shown = np.array([name not in hidden for name in coordinates.free], float)
    spread = typical_spread(hidden, parameters(end.model))
    middle = np.array([float(value_at(end.model, name)) for name in hidden])
    draws = middle + spread * np.random.default_rng(0).normal(size=(_DRAWS, len(hidden)))
    others = [with_values(end.model, dict(zip(hidden, draw, strict=True))) for draw in draws]
    coordinates = coordinates.around(end.model)
    t = coordinates.inverse(end.model)
    scores = scores_of_outlines(coordinates, t, view, others) / coordinates.slopes(t)
    both = np.outer(shown, shown)
    return dataclasses.replace(
        end,
        information=end.information * both,
        score_covariance=(end.score_covariance + scores.T @ scores / _DRAWS) * both,
    )
