"""The colours of a cloud as a texture of a surface."""

from __future__ import annotations

import jax
import numpy as np

from petalfit.fitting.likelihood.foot_points import guess_foot_points
from petalfit.observations import PointCloud, TargetError, Texture
from petalfit.residuals import refine_foot_points
from petalfit.results import FitRecord
from petalfit.surfaces import AbstractSurface


def colours_on(surface: AbstractSurface | FitRecord, cloud: PointCloud) -> Texture:
    """The colours of a cloud at its foot points on a surface.

    Args:
        surface: A surface in the cloud's frame, or the result of a fit to the cloud.
        cloud: A cloud with colours.

    Raises:
        TargetError: The cloud has no colours.
    """
    if cloud.colours is None:
        raise TargetError("the cloud has no colours; give red, green and blue of every point.")
    points, model = cloud.points, surface
    if isinstance(surface, FitRecord):
        pose, model = surface.pose, surface.model
        points = pose.into(points)
    assert isinstance(model, AbstractSurface)
    with jax.enable_x64(True):
        uv = refine_foot_points(model, points, guess_foot_points(model, points), 3)
    low, high = np.array(model.domain).T
    places = np.clip((uv - low) / (high - low), 0, 1) - [0.5, 0.0]
    return Texture.at(places, cloud.colours, cloud.weights)
