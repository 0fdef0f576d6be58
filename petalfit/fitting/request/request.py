"""The request of a fit: everything that is asked for, in one checked value."""

from __future__ import annotations

import dataclasses

import numpy as np

from petalfit.fitting.outliers.linear import Linear
from petalfit.fitting.outliers.loss import AbstractLoss
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.request.targets import is_one_image
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.observations import AbstractObservation, PointCloud
from petalfit.surfaces import AbstractSurface, Pose


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Request:
    """Everything that a fit is asked for.

    Attributes:
        template: A component. Parameters that are not free keep its values.
        free: Names of the free parameters; once `run` has chosen a pose, they include those of the pose.
        targets: The observations, which are fitted jointly.
        pose: "known", "rigid" or "similarity".
        loss: The loss, which treats points that may not belong to the surface.
        noise: σ of the clouds' noise; None to estimate it.
        from_template: Whether to start at the template instead of searching for a start.
        begun: The pose to start from, in the target's frame or in pixels, if the template is to be
            started from in a fitted pose or in an image.
        seed: The seed of random choices.
        base: A point near the base of the petal, in the targets' frame or in pixels; None if it is not
            known which end is the base.
        every_point: Whether every step takes every point of a large cloud, which is slow and changes the
            answer by less than its errors.
        ends_only: Whether to leave out the correction of the bias and the errors, which take long for
            silhouettes.
    """

    template: AbstractSurface
    free: tuple[str, ...]
    targets: tuple[AbstractObservation, ...]
    pose: str = "known"
    loss: AbstractLoss = dataclasses.field(default_factory=Linear)
    noise: float | None = None
    from_template: bool = False
    begun: Pose | None = None
    seed: int = 0
    base: tuple[float, ...] | None = None
    every_point: bool = False
    ends_only: bool = False

    @property
    def cloud(self) -> PointCloud:
        """The only target, which must be a cloud."""
        (cloud,) = self.targets
        assert isinstance(cloud, PointCloud)
        return cloud

    @property
    def is_one_cloud(self) -> bool:
        """Whether the only target is a cloud."""
        return len(self.targets) == 1 and isinstance(self.targets[0], PointCloud)

    @property
    def is_one_image(self) -> bool:
        """Whether the only target is a mask without a camera."""
        return is_one_image(self.targets)


def scan_of(request: Request, frame: NormalisedFrame, shuffled: bool) -> tuple[Scan, np.ndarray]:
    """The points of a request's cloud that have a weight, in a frame.

    Args:
        request: A request whose only target is a cloud.
        frame: The frame.
        shuffled: Whether to bring the points into a random order, in which any first part is a fair
            sample; else they keep their order.

    Returns:
        The scan, and the index of each of its points among those that have a weight.
    """
    cloud = request.cloud
    used = cloud.mass > 0
    points, weights = cloud.points[used], cloud.mass[used]
    own, noise = frame.into(points), request.noise
    order = frame.order(points if shuffled else own, request.seed)
    noise = None if noise is None else noise / frame.unit
    every = np.arange(len(own))
    asked = noise, request.loss, request.every_point
    if shuffled:
        return Scan.of(own[order], weights[order], every, *asked), order
    return Scan.of(own, weights, order, *asked), every
