"""Synthetic masks of a petal: exact ones of a camera, or ones with a noisy edge."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from petalfit.observations import Camera, Silhouette
from petalfit.surfaces import AbstractSurface, coverage, outline_rings

_FINER = 4  # distances from the edge are measured at this multiple of the resolution
# Rotations and places are rounded, because their last bits depend on the processor and files must not.
_DECIMALS = 7


@dataclasses.dataclass(frozen=True)
class Sight:
    """An orthographic view of a petal, and the kind of mask that is made from it.

    Attributes:
        eye: The direction from the target to the camera.
        target: The place that the camera looks at, in the petal's frame.
        pixels_per_unit: The number of pixels per unit of length.
        shape: The numbers of rows and columns of the image.
        kind: The kind of mask, "binary" or "coverage".
        edge: The standard deviation, in pixels, by which the mask's edge is displaced, smoothly along it;
            0 for an exact edge.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    pixels_per_unit: float
    shape: tuple[int, int] = (256, 256)
    kind: str = "binary"
    edge: float = 0.0

    def camera_json(self) -> dict[str, Any]:
        """The arguments of `Camera.orthographic`, rounded."""
        place = np.add(self.eye, self.target)
        camera = Camera.look_at(
            place, self.target, self.shape, pixels_per_unit=self.pixels_per_unit
        )
        return {
            "rotation": _rounded(camera.rotation),
            "pixels_per_unit": self.pixels_per_unit,
            "centre": _rounded(camera.matrix[:2, 3]),
            "shape": list(self.shape),
        }

    def mask(self, surface: AbstractSurface, seed: int) -> Silhouette:
        """The mask of a surface; `seed` is the seed of the noise of its edge."""
        camera = Camera.from_json(self.camera_json())
        rings = outline_rings(surface, camera)
        seen = coverage(rings, self.shape)
        if self.edge:
            return Silhouette(_displaced(rings, self.shape, self.edge, seed), camera)
        return Silhouette(seen >= 0.5 if self.kind == "binary" else seen, camera)


def _rounded(numbers: np.ndarray) -> list[Any]:
    """Rounded numbers as lists; adding 0 removes the sign of negative zeros."""
    return (np.round(numbers, _DECIMALS) + 0.0).tolist()


def _displaced(
    rings: list[np.ndarray], shape: tuple[int, int], sigma: float, seed: int
) -> np.ndarray:
    """A mask whose edge a smooth random field displaces along its normal; only its largest piece."""
    from scipy import ndimage

    fine = (
        coverage([_FINER * ring for ring in rings], (_FINER * shape[0], _FINER * shape[1])) >= 0.5
    )
    inside, outside = np.empty((2, *fine.shape))
    ndimage.distance_transform_edt(fine, distances=inside)
    ndimage.distance_transform_edt(~fine, distances=outside)
    distance = (inside - outside).reshape(shape[0], _FINER, shape[1], _FINER)
    distance = distance.mean(axis=(1, 3)) / _FINER
    width = 3.0
    field = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), width)
    # Smoothing reduces the standard deviation of white noise to 1/(2 √π width).
    mask = distance + sigma * 2 * math.sqrt(math.pi) * width * field > 0
    labels = np.empty(shape, np.int32)
    ndimage.label(mask, output=labels)
    return labels == np.argmax(np.bincount(labels.ravel())[1:]) + 1
