"""Residuals of all points of a cloud, including those that had no weight in the fit."""

from __future__ import annotations

import dataclasses

import numpy as np

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood import programs
from petalfit.fitting.likelihood.cloud import ObservedCloud, pad
from petalfit.fitting.likelihood.foot_points import guess_foot_points
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import PointCloud


def with_all_points(
    coordinates: Coordinates, end: Iterate, number: int, cloud: PointCloud
) -> Iterate:
    """The end of a fit with the residuals of all points of a cloud, including those without weight.

    Args:
        coordinates: The free parameters.
        end: The end. Its residuals are those of the points with weight, followed by padding.
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
        data = pad(cloud.points[~used], np.ones(size - count), seen.noise)
        uv_rest = programs.refine(
            end.model, data.points, guess_foot_points(end.model, data.points), 3
        )
        others = ObservedCloud(data)
        t = coordinates.inverse(end.model)
        (rest,) = others.residuals(coordinates, t, others.at(uv_rest))
        assert rest.uv is not None
        distance[~used], uv[~used] = rest.distance[: size - count], rest.uv[: size - count]
    seen = seen._replace(distance=distance, weights=weights, uv=uv)
    parts = (*end.residuals[:number], seen, *end.residuals[number + 1 :])
    return dataclasses.replace(end, residuals=parts)
