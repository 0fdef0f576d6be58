"""Reading a target from a file of any kind."""

from __future__ import annotations

import os
from pathlib import Path

from petalfit.observations.camera import Camera
from petalfit.observations.images import IMAGE_SUFFIXES
from petalfit.observations.point_cloud import PointCloud
from petalfit.observations.silhouette import Silhouette


def read_target(
    path: str | os.PathLike[str], camera: Camera | None = None
) -> PointCloud | Silhouette:
    """Reads an image as a mask, and any other file as a point cloud.

    Args:
        path: The path of the file.
        camera: The camera of the mask, if the file is an image.

    Raises:
        TargetError: The file cannot be read, or its content cannot be used.
    """
    if Path(path).suffix.lower() in IMAGE_SUFFIXES:
        return Silhouette.load(path, camera)
    return PointCloud.load(path)
