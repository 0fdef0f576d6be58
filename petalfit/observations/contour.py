"""The contour of a silhouette, located to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Shaped

from petalfit.observations.camera import Camera
from petalfit.observations.errors import TargetError
from petalfit.observations.silhouette import Silhouette

_MOST = 2048  # the largest number of places; a longer contour is sampled more widely
_REACH = 3.0  # steps to either side of a place, between which its tangent is taken
_SPECK = 0.05  # a contour below this fraction of the longest is that of a speck or a pinhole
_BORDER = 1  # pixels along the border, where the contour is that of the image and not of the petal
_FEWEST = 12


@dataclass(frozen=True, eq=False)
class Contour:
    """Evenly spaced places on the contours where the coverage is one half.

    Attributes:
        camera: The camera of the silhouette; for a silhouette without one, a camera that maps x and y of
            the target's frame to pixels unchanged.
        place: The places (x, y) in pixels, shape (n, 2).
        normal: Unit normals that point out of the petal, shape (n, 2).
        length: The length of contour that each place stands for, in pixels, times its weight, shape (n,).
        binary: Whether the mask was black and white.
    """

    camera: Camera
    place: Float64[np.ndarray, "n 2"]
    normal: Float64[np.ndarray, "n 2"]
    length: Float64[np.ndarray, " n"]
    binary: bool
    _weights: Float64[np.ndarray, "h w"]

    @classmethod
    def of(cls, silhouette: Silhouette) -> Contour:
        """The contour of a silhouette.

        Raises:
            TargetError: Too little of the contour can be trusted.
        """
        mask = silhouette.mask
        camera = silhouette.camera
        if camera is None:
            camera = Camera.orthographic(np.eye(3), 1.0, (0.0, 0.0), mask.shape)
        weights = _trusted(silhouette)
        place, normal, length = trace(mask)
        contour = cls(camera, place, normal, length, silhouette.is_binary, weights)
        length = length * contour.trust(place)
        if np.count_nonzero(length) < _FEWEST:
            raise TargetError(
                "too little of the mask's contour can be trusted: nearly all of it lies at the border "
                "of the image or has weight 0; take a wider image."
            )
        return cls(camera, place, normal, length, contour.binary, weights)

    @property
    def size(self) -> float:
        """The diagonal of the bounding box of the contour, in pixels."""
        return float(np.hypot(*np.ptp(self.place, axis=0)))

    def trust(self, places: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """The weights of the mask at places of the image; 0 outside the image and along its border."""
        rows, columns = self._weights.shape
        column, row = np.floor(places).astype(int).T
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        found = self._weights[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.where(inside, found, 0.0)


def trace(
    mask: Shaped[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Places along the outer contours at coverage ½, outward normals, and lengths, all in pixels.

    Rims of holes are left out: no surface has holes.
    """
    from skimage.measure import find_contours

    if not mask.any():
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    # Contours are traced only in the box around the object: large images are mostly background.
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left = max(rows[0] - 1, 0), max(columns[0] - 1, 0)
    inner = mask[top : rows[-1] + 2, left : columns[-1] + 2]
    # scikit-image gives rows and columns of pixel centres, which become x and y.
    curves = [curve[:, ::-1] + (left + 0.5, top + 0.5) for curve in find_contours(inner, 0.5)]
    curves = [curve for curve in curves if not _is_rim_of_hole(curve)]
    runs = [np.append(0.0, np.cumsum(np.hypot(*np.diff(curve, axis=0).T))) for curve in curves]
    longest = max((run[-1] for run in runs), default=0.0)
    kept = [k for k, run in enumerate(runs) if run[-1] >= max(_SPECK * longest, 8.0)]
    step = max(1.0, sum(runs[k][-1] for k in kept) / _MOST)
    pieces = [_evenly(curves[k], runs[k], step) for k in kept]
    if not pieces:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    place, tangent, length = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    # scikit-image runs along every contour with the covered area on the same side.
    return place, np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1), length


def _is_rim_of_hole(curve: np.ndarray) -> bool:
    """Whether a closed curve has the covered area around it, which is a matter of its direction."""
    x, y = curve.T
    is_closed = bool(np.all(curve[0] == curve[-1]))
    return is_closed and float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) < 0


def _evenly(
    curve: np.ndarray, run: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evenly spaced places along a polygon, with unit tangents and lengths."""
    total, closed = run[-1], bool(np.all(curve[0] == curve[-1]))
    count = max(4, round(total / step))
    along = (np.arange(count) + 0.5) * total / count

    def at(places: np.ndarray) -> np.ndarray:
        places = places % total if closed else np.clip(places, 0.0, total)
        return np.stack([np.interp(places, run, column) for column in curve.T], axis=-1)

    tangent = at(along + _REACH * step) - at(along - _REACH * step)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-12
    return at(along), tangent, np.full(count, total / count)


def _trusted(silhouette: Silhouette) -> np.ndarray:
    """The weights of the pixels; 0 next to pixels of weight 0, and along the border of the image."""
    from scipy.ndimage import minimum_filter

    weights = silhouette.weights
    weights = np.ones_like(silhouette.mask) if weights is None else minimum_filter(weights, 3)
    return np.pad(weights[_BORDER:-_BORDER, _BORDER:-_BORDER], _BORDER)
