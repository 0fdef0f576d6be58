"""Targets: everything that can be turned into an observation, or into a list of observations."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from petalfit.observations import (
    AbstractObservation,
    Camera,
    PointCloud,
    Silhouette,
    TargetError,
    as_point_cloud,
    looks_like_a_mask,
    read_targets,
)


def as_targets(target: object, camera: Camera | None) -> list[AbstractObservation]:
    """Turns targets into observations without repeated points.

    Args:
        target: A cloud, a mask, or a list of these; see `petalfit.fit`.
        camera: The camera of masks that are arrays or files.

    Raises:
        TargetError: A target cannot be used, or no target needs the camera.
    """
    parts = target if isinstance(target, list | tuple) and _is_list_of_targets(target) else [target]
    observations = [read.each_once() for part in parts for read in _as_targets(part, camera)]
    if camera is not None and not any(isinstance(part, Silhouette) for part in observations):
        raise TargetError("camera is for masks, and there is none among the targets; leave it out.")
    return observations


def with_noise_of_points(
    targets: list[AbstractObservation], noise: float | Float[np.ndarray, " n"] | None
) -> tuple[list[AbstractObservation], float | None]:
    """The targets with weights for the precision of their points, and the noise of a point of weight 1.

    Args:
        targets: A single cloud, if `noise` is an array; else any targets.
        noise: Standard deviations of all points, positive, shape (n,); or one number or None, which is
            returned as it is.

    Raises:
        TargetError: There are other targets than one cloud, or `noise` does not have one value a point.
    """
    if not isinstance(noise, np.ndarray):
        return targets, noise
    cloud = targets[0]
    if len(targets) > 1 or not isinstance(cloud, PointCloud):
        raise TargetError("a noise for each point is there for one cloud; give one number.")
    if noise.shape != (len(cloud),):
        raise TargetError(
            f"noise has shape {noise.shape}; give one number, or one for each of the {len(cloud)} points."
        )
    typical = float(np.mean(noise**-2.0) ** -0.5)
    return [cloud.weighted((typical / noise) ** 2)], typical


def _is_list_of_targets(target: list | tuple) -> bool:
    """Whether a list holds targets, and not rows of coordinates or of pixels."""
    kinds = (AbstractObservation, str, os.PathLike)
    return any(
        isinstance(part, kinds) or hasattr(part, "vertices") or np.ndim(part) == 2
        for part in target
    )


def _as_targets(target: object, camera: Camera | None) -> list[AbstractObservation]:
    """The observations that a target is or, if it is the folder of a capture, has."""
    if isinstance(target, str | os.PathLike):
        return [*read_targets(target, camera)]
    return [_as_target(target, camera)]


def _as_target(target: object, camera: Camera | None) -> AbstractObservation:
    if isinstance(target, Silhouette):
        if target.camera is None and camera is not None:
            return Silhouette(target.mask, camera, target.weights)
        return target
    if isinstance(target, AbstractObservation):
        return target
    if isinstance(target, np.ndarray) and looks_like_a_mask(target, camera):
        return Silhouette(target, camera)
    return as_point_cloud(target)


def is_one_image(targets: Sequence[AbstractObservation]) -> bool:
    """Whether the only one of some targets is a mask without a camera."""
    first, *others = targets
    return not others and isinstance(first, Silhouette) and first.camera is None
