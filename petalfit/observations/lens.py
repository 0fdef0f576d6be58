"""Distortion by a lens, in the model of OpenCV: where a place of an ideal image appears in a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from petalfit.observations.errors import TargetError

_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_STEPS = 512  # radii at which it is checked that the distortion does not fold


@dataclass(frozen=True)
class Lens:
    """The distortion of a lens: tangential and radial, or that of a fisheye.

    With (x, y) = ((column − c_x)/f_x, (row − c_y)/f_y) and r² = x² + y², a place appears at

        x (1 + k₁r² + k₂r⁴ + k₃r⁶)/(1 + k₄r² + k₅r⁴ + k₆r⁶) + 2p₁xy + p₂(r² + 2x²),

    and likewise y, with p₁ and p₂ exchanged. A fisheye multiplies x and y by θ(1 + k₁θ² + k₂θ⁴ + k₃θ⁶ +
    k₄θ⁸)/r with θ = arctan r.

    Attributes:
        focal: The focal lengths f_x and f_y, in pixels.
        centre: The principal point c_x and c_y, in pixels.
        coefficients: (k₁, k₂, p₁, p₂, k₃, k₄, k₅, k₆), or (k₁, k₂, k₃, k₄) of a fisheye.
        fisheye: Whether it is a fisheye.
    """

    focal: tuple[float, float]
    centre: tuple[float, float]
    coefficients: tuple[float, ...]
    fisheye: bool = False

    def distorted(self, places: Float[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n 2"]:
        """The places in the photo where places of the ideal image appear, both in pixels."""
        normal = (places - np.array(self.centre)) / np.array(self.focal)
        x, y = normal[..., 0], normal[..., 1]
        square = x**2 + y**2
        if self.fisheye:
            factor = self._radial(np.sqrt(square))
            moved = normal * factor[..., None]
        else:
            p1, p2 = self.coefficients[2:4]
            factor = self._radial(np.sqrt(square))
            across = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x**2)
            down = y * factor + 2 * p2 * x * y + p1 * (square + 2 * y**2)
            moved = np.stack([across, down], axis=-1)
        return moved * np.array(self.focal) + np.array(self.centre)

    def sees(self, places: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether places of the ideal image lie where the distortion is still one to one."""
        normal = (places - np.array(self.centre)) / np.array(self.focal)
        radius = np.linalg.norm(normal, axis=-1)
        tried = np.linspace(0.0, float(radius.max(initial=0.0)), _STEPS)
        folds = np.flatnonzero(np.diff(tried * self._radial(tried)) <= 0)
        return radius <= (tried[folds[0]] if len(folds) and tried[-1] > 0 else np.inf)

    def _radial(self, radius: np.ndarray) -> np.ndarray:
        """The factor by which a place moves away from the principal point."""
        if self.fisheye:
            k = self.coefficients
            theta = np.arctan(radius)
            square = theta**2
            bent = theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
            return np.where(radius > 1e-9, bent / np.maximum(radius, 1e-9), 1.0)
        k1, k2, _, _, k3, k4, k5, k6 = self.coefficients
        square = radius**2
        above = 1 + square * (k1 + square * (k2 + square * k3))
        return above / (1 + square * (k4 + square * (k5 + square * k6)))


def lens_of(
    intrinsics: Float64[np.ndarray, "3 3"],
    distortion: Float64[np.ndarray, " n"],
    fisheye: bool,
    shape: tuple[int, int],
    negligible: float,
) -> Lens | None:
    """The lens of a camera; None if it moves no place of the image by more than `negligible` pixels.

    Args:
        intrinsics: The intrinsic matrix.
        distortion: Coefficients in the order of OpenCV; missing ones are 0.
        fisheye: Whether the lens is a fisheye.
        shape: The numbers of rows and columns of the image.
        negligible: In pixels.

    Raises:
        TargetError: There are more coefficients than are known.
    """
    most = 4 if fisheye else len(_COEFFICIENTS)
    if distortion[most:].any():
        raise TargetError(
            f"the lens has {len(distortion)} coefficients of distortion, of which {most} are known; "
            "undistort the images first."
        )
    coefficients = np.zeros(most)
    coefficients[: len(distortion)] = distortion[:most]
    if not (fisheye or coefficients.any()):
        return None
    lens = Lens(
        (float(intrinsics[0, 0]), float(intrinsics[1, 1])),
        (float(intrinsics[0, 2]), float(intrinsics[1, 2])),
        tuple(map(float, coefficients)),
        fisheye,
    )
    rows, columns = shape
    rim = np.stack(np.meshgrid(np.linspace(0, columns, 33), np.linspace(0, rows, 33)), axis=-1)
    with np.errstate(all="ignore"):
        moved = np.abs(lens.distorted(rim) - rim).max()
    return None if moved <= negligible else lens
