"""Annealing: weights fall with distance, on a scale that shrinks while the surface comes nearer.

Far from the truth, a wide kernel keeps points that a narrow one would reject (graduated non-convexity;
Blake and Zisserman, 1987). At the end the points are a mixture of the surface and its background.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.foot_points import signed_distance
from petalfit.fitting.likelihood.scales import geman_mcclure, spread_of
from petalfit.fitting.outliers.loss import AbstractBackground
from petalfit.fitting.solver.alternate import minimise
from petalfit.fitting.solver.iterate import Iterate
from petalfit.residuals import Data, TangentDistance
from petalfit.surfaces import AbstractSurface

# Scales of the kernel in robust standard deviations of the distances, and the factor between two of them.
_WIDEST, _NARROWEST, _NARROWING = 6.0, 3.0, 0.6
_AT_ONCE, _ROUNDS = 3, 36  # rounds between two mixtures, and all together
_TOLERANCE = 0.02  # standard errors
# The least scale of the kernel, relative to the extent: some points have no noise at all.
_EXACT = 1e-12
_UNCHANGED = 0.02  # a smaller change of a probability is none
_NONE = 1e-6  # a smaller probability to belong to the surface is none


def approach(
    coordinates: Coordinates,
    background: AbstractBackground,
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
) -> Iterate:
    """Brings a rough start near to the surface, with a kernel that narrows.

    Args:
        coordinates: The free parameters.
        background: The model of points that do not belong to the surface.
        model: The start.
        points: Points that seem to belong to a surface.
        weights: The number of observations that each point counts for.

    Returns:
        The end, with the mixture of its points.
    """
    cloud = ObservedCloud(Data.of(points, weights, None))
    term, scale = cloud.match(model, None), np.inf
    least = _EXACT * float(np.linalg.norm(np.ptp(points, axis=0)))
    while True:
        distance = signed_distance(*cloud.apart(model, term))
        narrowest = max(_NARROWEST * spread_of(distance), least)
        scale = min(_WIDEST / _NARROWEST * narrowest, scale)
        kept = weights * geman_mcclure(distance, max(scale, narrowest))
        end = _followed(coordinates, model, points, kept, None, term.uv, 2, 0.3)
        model, term = end.model, cloud.match(end.model, term_of(end))
        if scale <= narrowest:
            found = background.mixture(model, *cloud.apart(model, term), weights, None)
            return dataclasses.replace(end, mixture=found)
        scale *= _NARROWING


def clear(
    coordinates: Coordinates,
    background: AbstractBackground,
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    noise: float | None,
    prior: Prior | None,
) -> Iterate:
    """Brings a start near the surface to the likeliest surface, and finds the points that belong to it.

    Args:
        coordinates: The free parameters.
        background: The model of points that do not belong to the surface.
        model: The start.
        points: All points that have a weight.
        weights: The number of observations that each point counts for.
        noise: σ, or None to estimate it.
        prior: The prior on the coordinates; None for no prior.

    Returns:
        The end, with the mixture of its points.
    """
    cloud = ObservedCloud(Data.of(points, weights, noise))
    term, rounds, members = cloud.match(model, None), 0, None
    while True:
        found = background.mixture(model, *cloud.apart(model, term), weights, noise)
        # Of a surface that is no longer finite no point is a member.
        kept = np.nan_to_num(weights * found.members)
        # Only points that may belong to the surface take part in the steps.
        some = np.flatnonzero(kept >= _NONE * np.max(kept))  # all, if none belongs to it
        end = _followed(
            coordinates, model, points[some], kept[some], noise, term.uv[some],
            _AT_ONCE, _TOLERANCE, prior,
        )  # fmt: skip
        rounds, model = rounds + end.rounds, end.model
        term = cloud.match(model, dataclasses.replace(term, sigma=term_of(end).sigma))
        changed = 1.0 if members is None else float(np.max(np.abs(found.members - members)))
        members = found.members
        done = end.moved <= _TOLERANCE and changed < _UNCHANGED
        if done or rounds >= _ROUNDS or np.isinf(end.moved):
            whole = TangentDistance(data=Data.of(points, kept, noise), uv=term.uv, sigma=term.sigma)
            return dataclasses.replace(end, terms=(whole,), rounds=rounds, mixture=found)


def _followed(
    coordinates: Coordinates,
    model: AbstractSurface,
    points: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    noise: float | None,
    uv: Float[np.ndarray, "n 2"],
    rounds: int,
    tolerance: float,
    prior: Prior | None = None,
) -> Iterate:
    """The end of a few rounds of the solver on points with these weights."""
    seen = ObservedCloud(Data.of(points, weights, noise))
    return minimise(coordinates, [seen], model, [seen.at(uv)], rounds, tolerance, prior)


def term_of(end: Iterate) -> TangentDistance:
    """The term of an end whose only observation is a cloud."""
    (term,) = end.terms
    assert isinstance(term, TangentDistance)
    return term
