"""Reading a target from a file of any kind."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from petalfit.observations.camera import Camera
from petalfit.observations.capture import read_capture
from petalfit.observations.errors import TargetError
from petalfit.observations.images import IMAGE_SUFFIXES
from petalfit.observations.point_cloud import PointCloud
from petalfit.observations.silhouette import Silhouette


def read_targets(
    path: str | os.PathLike[str], camera: Camera | None = None
) -> list[PointCloud | Silhouette]:
    """Reads the targets in a file or in the folder of a capture; see `read_target`, `read_capture`.

    Raises:
        TargetError: Something cannot be read or used, or a camera is given for a folder, which has its
            own.
    """
    if not Path(path).is_dir():
        return [read_target(path, camera)]
    if camera is not None:
        raise TargetError(f"{path} is a folder with cameras of its own; leave the camera out.")
    return [*read_capture(path)]


def read_target(
    path: str | os.PathLike[str], camera: Camera | None = None
) -> PointCloud | Silhouette:
    """Reads an image, or an array that looks like one, as a mask, and any other file as a point cloud.

    Args:
        path: The path of the file.
        camera: The camera of the mask, if the file is an image.

    Raises:
        TargetError: The file cannot be read, or its content cannot be used.
    """
    if is_mask_file(path, camera):
        return Silhouette.load(path, camera)
    return PointCloud.load(path)


def is_mask_file(path: str | os.PathLike[str], camera: Camera | None = None) -> bool:
    """Whether a file is read as a mask."""
    if Path(path).suffix.lower() != ".npy":
        return Path(path).suffix.lower() in IMAGE_SUFFIXES
    try:
        header = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception:  # NumPy raises errors of any kind; the reader of clouds says what is wrong
        return False
    return isinstance(header, np.ndarray) and looks_like_a_mask(header, camera)


def looks_like_a_mask(array: Shaped[np.ndarray, "..."], camera: Camera | None) -> bool:
    """Whether an array is a mask, not a cloud of shape (N, 3). Pictures count; the mask refuses them."""
    if array.ndim == 3:
        return True
    return array.ndim == 2 and (array.dtype == bool or camera is not None or min(array.shape) > 8)
