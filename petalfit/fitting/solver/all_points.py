"""Residuals of all points of a cloud, including those that had no weight in the fit."""

from __future__ import annotations

import dataclasses

import numpy as np

from petalfit.fitting.likelihood.foot_points import beside, guess_foot_points, signed_distance
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import PointCloud
from petalfit.residuals import refine_foot_points


def with_all_points(end: Iterate, number: int, cloud: PointCloud) -> Iterate:
    """The end of a fit with the residuals of all points of a cloud, including those without weight.

    Args:
        end: The end. Its residuals are those of the points with weight.
        number: The index of the cloud among the observations.
        cloud: The cloud.
    """
    seen = end.residuals[number]
    assert seen.uv is not None
    size = len(cloud)
    used = cloud.mass > 0
    count = np.count_nonzero(used)
    distance, uv, weights = np.empty(size), np.empty((size, 2)), np.zeros(size)
    distance[used], uv[used] = seen.distance[:count], seen.uv[:count]
    weights[used] = seen.weights[:count]
    if count < size:
        model, points = end.model, cloud.points[~used]
        uv[~used] = refine_foot_points(model, points, guess_foot_points(model, points), 3)
        distance[~used] = signed_distance(*beside(model, points, uv[~used]))
    seen = seen._replace(distance=distance, weights=weights, uv=uv)
    parts = (*end.residuals[:number], seen, *end.residuals[number + 1 :])
    return dataclasses.replace(end, residuals=parts)
