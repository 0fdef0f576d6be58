"""The colours of a cloud as a texture of a surface."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from petalfit.compilation import bucket, pad_to
from petalfit.fitting.coordinates import in_doubles
from petalfit.fitting.likelihood import programs
from petalfit.fitting.likelihood.foot_points import guess_foot_points
from petalfit.observations import PointCloud, TargetError, Texture
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
        rotation, shift = np.asarray(pose.rotation), np.asarray(pose.translation)
        points = (points - shift) @ rotation / float(pose.scale)
    assert isinstance(model, AbstractSurface)
    with jax.enable_x64(True):
        rows = pad_to(points, bucket(len(points)))
        model = in_doubles(model)
        uv = programs.refine(model, rows, guess_foot_points(model, jnp.asarray(rows)), 3)
    low, high = np.array(model.domain).T
    places = np.clip((np.asarray(uv)[: len(points)] - low) / (high - low), 0, 1) - [0.5, 0.0]
    return Texture.at(places, cloud.colours, cloud.weights)
