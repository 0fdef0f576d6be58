"""The normalised frame of a cloud, in which it is fitted: results do not depend on the given frame."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from petalfit.components import Posed
from petalfit.fitting.coordinates import in_doubles
from petalfit.fitting.likelihood.observed import Residuals

# Of the extent, which no instrument tells apart. A cloud that comes turned or in another unit differs by
# the last bits of float64; with these cut off its fit takes the same steps, bit by bit.
_GRAIN = 2.0**-30


@dataclasses.dataclass(frozen=True)
class NormalisedFrame:
    """The middle, the principal axes and the extent of a cloud as its frame.

    Attributes:
        axes: Its axes in the target's frame, as columns.
        centre: Its origin there.
        unit: Its unit of length there.
        exact: Whether points keep their last bits.
    """

    axes: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    unit: float
    exact: bool

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"], pose: str) -> NormalisedFrame:
        """The frame of a cloud; where the pose is known it is the target's own."""
        if pose == "known":
            return cls(np.eye(3), np.zeros(3), 1.0, exact=True)
        centre = points.mean(axis=0)
        centred = points - centre
        _, axes = np.linalg.eigh(centred.T @ centred)
        # The heavier tail of every axis points along it; the last one makes them right-handed.
        axes = axes * np.where(np.sum((centred @ axes) ** 3, axis=0) < 0, -1.0, 1.0)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        extent = float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))
        return cls(axes, centre, extent if pose == "similarity" else 1.0, exact=False)

    def into(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the target, in this frame."""
        own = (points - self.centre) @ self.axes / self.unit
        if self.exact:
            return own
        grain = _GRAIN * 2.0 ** np.floor(np.log2(np.ptp(own)))
        return np.round(own / grain) * grain

    def back(self, posed: Posed) -> Posed:
        """A component posed in this frame, in the target's; its turns and shifts are zero there."""
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
        """Residuals in this frame, in the target's unit."""
        return seen._replace(distance=self.unit * seen.distance, noise=self.unit * seen.noise)

    def order(self, points: Float[np.ndarray, "n 3"], seed: int) -> np.ndarray:
        """A random order that depends on where points are, and not on the order that they came in."""
        far = np.linalg.norm(points - points.mean(axis=0), axis=1)
        return np.argsort(far, kind="stable")[np.random.default_rng(seed).permutation(len(points))]
