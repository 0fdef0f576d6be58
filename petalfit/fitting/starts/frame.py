"""The normalised frame in which a cloud is fitted, so that results do not depend on the given one."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from petalfit.components import Posed
from petalfit.fitting.likelihood.observed import Residuals
from petalfit.surfaces import AbstractSurface, Pose, in_doubles

# Points are rounded to this grain, relative to the extent; no instrument is so precise. If a cloud is
# given turned or in another unit, its points differ by the last bits of float64. With these cut off, the
# fit takes the same steps, bit by bit.
_GRAIN = 2.0**-30


@dataclasses.dataclass(frozen=True)
class NormalisedFrame:
    """A frame given by the middle, the principal axes and the extent of a cloud.

    Attributes:
        axes: Axes of this frame in the target's frame, as columns, shape (3, 3).
        centre: Origin of this frame in the target's frame, shape (3,).
        unit: Unit of length of this frame, in the target's unit.
        exact: Whether points are not rounded.
    """

    axes: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    unit: float
    exact: bool

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"], pose: str) -> NormalisedFrame:
        """The frame of a cloud; if the pose is known it is the target's own."""
        if pose == "known":
            return cls(np.eye(3), np.zeros(3), 1.0, exact=True)
        centre = points.mean(axis=0)
        centred = points - centre
        _, axes = np.linalg.eigh(centred.T @ centred)
        # Each axis points to the heavier tail of the points along it; then the first one is turned, if
        # need be, to make the axes right-handed.
        along = centred @ axes
        axes = axes * np.where(np.sum(along * along * along, axis=0) < 0, -1.0, 1.0)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        extent = float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))
        return cls(axes, centre, extent if pose == "similarity" else 1.0, exact=False)

    def into(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transforms points of the target into this frame, and rounds them unless `exact`."""
        own = (points - self.centre) @ self.axes / self.unit
        if self.exact:
            return own
        grain = _GRAIN * 2.0 ** np.floor(np.log2(np.ptp(own)))
        return np.round(own / grain) * grain

    def placed(self, surface: AbstractSurface, pose: Pose) -> Posed:
        """A component in a pose of the target's frame, posed in this frame."""
        place = (np.asarray(pose.translation) - self.centre) @ self.axes / self.unit
        rotation = self.axes.T @ np.asarray(pose.rotation)
        return Posed(
            in_doubles(surface), rotation, place, np.float64(float(pose.scale) / self.unit)
        )

    def back(self, posed: Posed) -> Posed:
        """Transforms a posed component to the target's frame; its turns and shifts become zero."""
        placed = posed.placement
        place = self.unit * self.axes @ placed.translation + self.centre
        scale = self.unit * float(placed.scale)
        return Posed(
            in_doubles(posed.surface),
            self.axes @ np.asarray(placed.rotation),
            np.asarray(place),
            np.float64(scale),
        )

    def measured(self, seen: Residuals) -> Residuals:
        """Converts residuals from this frame's unit to the target's unit."""
        return seen._replace(distance=self.unit * seen.distance, noise=self.unit * seen.noise)

    def order(self, points: Float[np.ndarray, "n 3"], seed: int) -> np.ndarray:
        """A random order of points that depends on their positions, not on the order they came in."""
        far = np.linalg.norm(points - points.mean(axis=0), axis=1)
        return np.argsort(far, kind="stable")[np.random.default_rng(seed).permutation(len(points))]
