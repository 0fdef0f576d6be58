"""A file as what it holds."""

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
    """A mask if it is an image, else a cloud.

    Args:
        path: Of the file.
        camera: Of a mask.

    Raises:
        TargetError: It cannot be read, or used.
    """
    if Path(path).suffix.lower() in IMAGE_SUFFIXES:
        return Silhouette.load(path, camera)
    return PointCloud.load(path)
