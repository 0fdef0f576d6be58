"""Masks of photos with a distorting lens, as a pinhole camera would have seen them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from petalfit.observations.camera import Camera

_BLOCK = 1 << 20  # pixels that are moved at once
_BEYOND = 1.5  # how much farther than at the border a place beyond it may be moved


def undistorted(
    mask: Float64[np.ndarray, "h w"], weights: Float64[np.ndarray, "h w"] | None, camera: Camera
) -> tuple[Float64[np.ndarray, "i j"], Float64[np.ndarray, "i j"], Camera]:
    """The mask, its weights and the camera without the distortion.

    The image gets a margin if the petal lies so near the border that it would be moved out of it. Places
    that the photo does not show have weight 0.
    """
    from scipy.ndimage import map_coordinates

    assert camera.lens is not None
    margin = _margin(mask, camera)
    ideal = camera.pinhole(margin)
    rows, columns = ideal.shape
    known = np.ones(mask.shape) if weights is None else weights
    found, trusted = np.empty(ideal.shape), np.empty(ideal.shape)
    step = max(1, _BLOCK // columns)
    for top in range(0, rows, step):
        bottom = min(rows, top + step)
        y, x = np.mgrid[top:bottom, :columns] + 0.5 - margin
        places = np.stack([x, y], axis=-1)
        with np.errstate(all="ignore"):
            from_ = camera.lens.distorted(places)
        outside = ~(camera.lens.sees(places) & np.isfinite(from_).all(axis=-1))
        from_[outside] = -10.0
        # Pixel centres of a mask have whole numbers in SciPy.
        at = np.moveaxis(from_[..., ::-1] - 0.5, -1, 0)
        found[top:bottom] = map_coordinates(mask, at, order=1, mode="constant")
        trusted[top:bottom] = map_coordinates(known, at, order=0, mode="constant")
        seen = (from_ >= 0).all(axis=-1) & (from_ <= np.array(mask.shape[::-1])).all(axis=-1)
        trusted[top:bottom] *= seen
    return np.clip(found, 0.0, 1.0), trusted, ideal


def _margin(mask: np.ndarray, camera: Camera) -> int:
    """Pixels to add on each side, so that nothing covered is moved out of the image."""
    assert camera.lens is not None
    rows, columns = mask.shape
    x, y = np.meshgrid(np.linspace(0, columns, 65), np.linspace(0, rows, 65))
    rim = np.stack([x, y], axis=-1)
    rim = np.concatenate([rim[0], rim[-1], rim[:, 0], rim[:, -1]])
    with np.errstate(all="ignore"):
        moved = np.abs(camera.lens.distorted(rim) - rim)
    reach = int(np.ceil(min(_BEYOND * float(np.nan_to_num(moved).max()), 0.5 * max(rows, columns))))
    inner = mask[reach + 1 : -reach - 1, reach + 1 : -reach - 1]
    return 0 if np.count_nonzero(inner >= 0.5) == np.count_nonzero(mask >= 0.5) else reach
