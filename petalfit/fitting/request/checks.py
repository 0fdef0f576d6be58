"""Checks of a request: each raises an error that says in one sentence what is not possible."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Real

from petalfit.components import Posed, parameters
from petalfit.fitting.outliers.loss import AbstractLoss
from petalfit.fitting.request.targets import is_one_image
from petalfit.observations import AbstractObservation, Contour, PointCloud, Silhouette, TargetError
from petalfit.surfaces import AbstractSurface

if TYPE_CHECKING:
    from petalfit.fitting.families.family import AbstractFamily
    from petalfit.fitting.request.request import Request

POSES = ("known", "rigid", "similarity")
_HEAVIEST = 1e9


def check_pose_name(pose: str) -> None:
    """Raises an error for a word that is no pose."""
    if pose not in POSES:
        raise ValueError(f"pose must be 'known', 'rigid' or 'similarity'; received {pose!r}")


def valid_noise(
    noise: float | Sequence[float] | Float[np.ndarray, " n"] | None,
) -> float | Float[np.ndarray, " n"] | None:
    """The noise as a positive length, or one for each point; None if it is to be estimated."""
    if noise is None:
        return None
    sigma = np.asarray(noise, np.float64)
    if sigma.ndim > 1 or not np.all(np.isfinite(sigma) & (sigma > 0)):
        raise ValueError(
            f"noise must be a positive length, one for each point, or None; received {noise}"
        )
    return sigma if sigma.ndim else float(sigma)


def valid_base(
    base: str | Sequence[float | int] | Real[np.ndarray, " n"] | None,
) -> tuple[float, ...] | None:
    """The point near the base; None if there is none, or if it is the other end that is asked for."""
    if base is None or (isinstance(base, str) and base == "other"):
        return None
    place = None if isinstance(base, str) else np.asarray(base, np.float64)
    if place is None or place.shape not in ((2,), (3,)) or not np.isfinite(place).all():
        raise ValueError(
            "base must be a point near the base, (x, y, z) or in an image (x, y), or 'other'; "
            f"received {base!r}"
        )
    return tuple(place.tolist())


def check_base(
    base: tuple[float, ...] | None, pose: str, targets: Sequence[AbstractObservation]
) -> None:
    """Raises an error for targets whose base is not sought, or a place with too many numbers or too few.

    Args:
        base: A place near the base, or None for the other end.
        pose: The pose that is asked for.
        targets: The targets.
    """
    in_image = is_one_image(targets)
    clouds = [target for target in targets if target.kind == "cloud"]
    if clouds and len(targets) > 1:
        raise TargetError("base is there for one cloud, or for masks; leave it out for joint fits.")
    if not in_image and pose == "known":
        raise TargetError(
            "with pose='known' the model's frame says where the base is; leave base out, or fit the pose."
        )
    if base is not None and len(base) != (2 if in_image else 3):
        raise TargetError(
            "base is a place in pixels (x, y) in an image, and a point (x, y, z) in space; received "
            f"{len(base)} numbers."
        )


def refuse(what: str, unused: Sequence[str]) -> None:
    """Raises an error for options that would have no effect."""
    if unused:
        raise TargetError(f"a fit of {what} does not use {' or '.join(unused)}; leave it out.")


def check_used(family: AbstractFamily, given: Sequence[str]) -> None:
    """Raises an error for options that the fits of a family do not use."""
    refuse(f"a {family.kind.__name__}", [name for name in given if name not in family.takes])


def check_pose(family: AbstractFamily, request: Request, posable: Sequence[str]) -> None:
    """Raises an error for a pose that does not go with the family, the model or the targets.

    Args:
        family: The family of the template.
        request: What is asked for.
        posable: Names of the models that can be fitted in that pose.
    """
    template, targets, pose = request.template, request.targets, request.pose
    kind = type(template).__name__
    masks = [target for target in targets if isinstance(target, Silhouette)]
    in_image = any(mask.camera is None for mask in masks)
    if pose != "known" or in_image:
        taken = [name for name in Posed.similarity if name in parameters(template)]
        if taken:
            raise TargetError(
                f"{', '.join(taken)} of {kind} are names of a pose's own parameters, which would be "
                "free too; rename them, or bring the target into the model's frame (pose='known')."
            )
    if pose == "known":
        return
    if request.from_template and request.begun is None:
        raise TargetError(
            f"init has no pose to start from; give an earlier result with pose={pose!r}, or leave it out."
        )
    if request.begun is not None and not request.is_one_cloud:
        raise TargetError(
            "an earlier result as init is there for one cloud; leave init out for masks and joint fits."
        )
    if len(masks) == len(targets):
        if pose == "similarity" or in_image:
            raise TargetError(
                f"pose={pose!r} does not go with these masks: with a camera for each the pose may "
                "be 'rigid'; without one it is 'known' to be a front view."
            )
        return
    if pose not in family.poses:
        raise TargetError(
            f"pose={pose!r} is there for {', '.join(posable)}; bring the target into the frame of a "
            f"{kind}."
        )
    if len(targets) > 1:
        raise TargetError(f"pose={pose!r} is there for one cloud, or for masks with cameras.")


def check_targets(
    family: AbstractFamily, template: AbstractSurface, targets: Sequence[AbstractObservation]
) -> None:
    """Raises an error for silhouettes and joint fits, if the family is for single clouds only."""
    if not family.sees_outlines and not (len(targets) == 1 and isinstance(targets[0], PointCloud)):
        raise TargetError(
            f"a {type(template).__name__} is fitted to one cloud; masks, or several targets, need "
            "another model."
        )


def check_loss(
    family: AbstractFamily,
    template: AbstractSurface,
    loss: AbstractLoss,
    targets: Sequence[AbstractObservation],
) -> None:
    """Raises an error for a robust loss, if the targets or the family do not allow for outliers."""
    if loss.name == "linear":
        return
    if not any(isinstance(target, PointCloud) for target in targets):
        raise TargetError(
            f"loss={loss.name!r} is there for clouds; masks discount outliers by themselves."
        )
    if not family.finds_outliers:
        raise TargetError(
            f"loss={loss.name!r} is there for components of one surface; a "
            f"{type(template).__name__} has several."
        )


def check_count(family: AbstractFamily, cloud: PointCloud, names: tuple[str, ...]) -> None:
    """Raises an error for a cloud of too few points."""
    count = np.count_nonzero(cloud.mass)
    if family.fewest is not None and count < family.fewest:
        raise TargetError(
            f"{count} points are too few for a {family.kind.__name__}; give {family.fewest} or more, or "
            "fit a model with fewer numbers."
        )
    if count < len(names) + 1:
        raise TargetError(
            f"{count} points cannot determine {len(names)} free parameters; at least "
            f"{len(names) + 1} are needed: give more points, or name fewer parameters in free."
        )


def check_weights(cloud: PointCloud) -> None:
    """Raises an error for weights that cannot be numbers of observations."""
    heaviest = float(np.max(cloud.mass))
    if heaviest > _HEAVIEST:
        raise TargetError(
            f"weights reach {heaviest:.3g}, where a weight is the number of observations that a point "
            f"counts for, at most {_HEAVIEST:g}: divide them by a common factor."
        )


def check_frame(cloud: PointCloud, template: AbstractSurface, pose: str) -> None:
    """Raises an error for a cloud whose unit puts its points beyond the reach of the model's ranges."""
    lengths = [p.bounds for p in parameters(template).values() if p.unit == "length"]
    if not lengths:
        return
    largest = max(max(abs(low), abs(high)) for low, high in lengths)
    reach = float(np.abs(cloud.points).max()) if pose == "known" else cloud.diagonal
    kind = type(template).__name__
    if reach > 10 * largest:
        raise TargetError(
            f"coordinates reach {reach:.3g} where the lengths of {kind} end at {largest:g}: bring the "
            "target to the model's unit and near its origin."
        )
    smallest = min((low for low, _ in lengths if low > 0), default=0.0)
    if cloud.diagonal < 0.1 * smallest:
        raise TargetError(
            f"the target is only {cloud.diagonal:.3g} across where the lengths of {kind} begin at "
            f"{smallest:g}: bring it to the model's unit."
        )


def check_view(contour: Contour, template: AbstractSurface) -> None:
    """Raises an error for a camera that does not see the places where the model may be."""
    camera = contour.camera
    corners = np.asarray(template.mesh((5, 5)).vertices)
    if camera.is_orthographic:
        return
    depth = camera.depth(corners)
    if depth.max() <= 0:
        raise TargetError(
            "the camera looks away from the petal, which lies behind it (z ≤ 0 in the camera's frame); "
            "OpenCV cameras look along +z, and with pose='known' the petal begins at the origin; "
            "pose='rigid' finds it anywhere."
        )
    if depth.min() <= 0:
        raise TargetError(
            "the camera stands in or beside the petal, part of which lies behind it; with pose='known' "
            "the petal begins at the origin and runs along +y, and pose='rigid' finds it anywhere."
        )
