"""The run of a fit: it turns a request into the ends of its starts."""

from __future__ import annotations

import dataclasses

import jax

from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.request.checks import check_count, check_frame, check_view, check_weights
from petalfit.fitting.request.request import Request
from petalfit.fitting.silhouettes.anywhere import fit_in_image, fit_views_anywhere
from petalfit.fitting.silhouettes.joint import fit_joint
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import Contour, PointCloud, Silhouette, TargetError


def run(family: AbstractFamily, request: Request) -> tuple[Request, list[Iterate]]:
    """Fit a component to its targets.

    Args:
        family: The family of the template.
        request: The request, checked except for what depends on the numbers in the targets.

    Returns:
        The request with the template and the names that were fitted, including those of a pose; and the
        end of each start, the best first, with residuals in the order of the targets.

    Raises:
        TargetError: The targets cannot be used with this model.
    """
    clouds = [target for target in request.targets if isinstance(target, PointCloud)]
    masks = [target for target in request.targets if isinstance(target, Silhouette)]
    for cloud in clouds:
        check_weights(cloud)
        if request.pose != "similarity":
            check_frame(cloud, request.template, request.pose)
    if request.is_one_cloud:
        names = family.free_in(request.pose, request.free)
        check_count(family, request.cloud, names if family.named_errors else ())
        with jax.enable_x64(True):
            ends = family.fit_cloud(request)
        return dataclasses.replace(request, free=names), ends
    contours = [Contour.of(mask) for mask in masks]
    with jax.enable_x64(True):
        if request.pose != "known":
            names = family.free_in(request.pose, request.free)
            request = dataclasses.replace(request, free=names)
            return request, fit_views_anywhere(family, request, contours)
        if any(mask.camera is None for mask in masks):
            if len(request.targets) > 1:
                raise TargetError(
                    "a mask without a camera can only be fitted alone: where the petal lies in its image "
                    "is not known. Give the camera of every mask."
                )
            request = dataclasses.replace(request, free=family.free_in_image(request.free))
            return request, fit_in_image(family, request, contours[0])
        for contour in contours:
            check_view(contour, request.template)
        return request, fit_joint(family, request)
