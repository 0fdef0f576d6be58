"""Camera files: one camera as JSON, or a NeRF tool's `transforms.json` (instant-ngp, nerfstudio)."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from petalfit.observations.camera import Camera
from petalfit.observations.errors import TargetError
from petalfit.observations.images import opened_image

# Cameras of NeRF tools look along −z with y up; ours look along +z with y down.
_FLIP = np.diag([1.0, -1.0, -1.0])
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


def read_transforms(path: str | os.PathLike[str]) -> dict[str, Camera]:
    """Reads the cameras of a `transforms.json`, one for each image, in the order of the file.

    The intrinsics may stand in each frame or at the top of the file: f_x and f_y in pixels or a
    horizontal angle, and the size of the image. A missing size is read from the image itself.

    Args:
        path: The path of the JSON file. Images are looked for in the same folder.

    Returns:
        A dictionary from the paths of the images, as the file gives them, to their cameras.

    Raises:
        TargetError: The file cannot be read, has another format, or has lens distortion.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        frames = content["frames"]
        cameras = {}
        for frame in frames:
            name = frame["file_path"]
            cameras[name] = _camera(content | frame, Path(path).parent / name)
    except TargetError as error:
        raise TargetError(f"{path}: {error}") from None
    except (OSError, ValueError) as error:
        raise TargetError(f"{path} cannot be read as cameras: {error}") from None
    except (AttributeError, KeyError, TypeError) as error:
        raise TargetError(
            f"{path} is no transforms.json of a NeRF tool ({error!r}); expected frames, each with "
            "file_path and transform_matrix."
        ) from None
    if not cameras:
        raise TargetError(f"{path} has no frames.")
    return cameras


def read_cameras(path: str | os.PathLike[str]) -> Camera | dict[str, Camera]:
    """Reads one camera (see `Camera.from_json`), or those of a `transforms.json` by image.

    Args:
        path: The path of the JSON file.

    Raises:
        TargetError: The file cannot be read, or has neither format.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise TargetError(f"{path} cannot be read as cameras: {error}") from None
    if isinstance(content, dict) and "frames" in content:
        return read_transforms(path)
    try:
        return Camera.from_json(content)
    except TargetError as error:
        raise TargetError(f"{path}: {error}") from None


def _camera(fields: dict[str, Any], image: Path) -> Camera:
    distorted = [name for name in _DISTORTION if float(fields.get(name, 0.0))]
    if distorted:
        raise TargetError(
            f"lens distortion ({', '.join(distorted)}) is not modelled; undistort the images first."
        )
    if "FISHEYE" in str(fields.get("camera_model", "")).upper():
        raise TargetError(
            f"the camera model {fields['camera_model']} is not known; undistort first."
        )
    if "w" in fields and "h" in fields:
        width, height = int(fields["w"]), int(fields["h"])
    else:
        width, height = _size(image)
    if "fl_x" in fields:
        focal_x = float(fields["fl_x"])
        focal_y = float(fields.get("fl_y", focal_x))
    else:
        angle = float(fields["camera_angle_x"])
        if not 0 < angle < math.pi:
            raise TargetError(f"camera_angle_x is {angle}; expected radians between 0 and π.")
        focal_x = focal_y = 0.5 * width / math.tan(0.5 * angle)
    centre = float(fields.get("cx", 0.5 * width)), float(fields.get("cy", 0.5 * height))
    pose = np.array(fields["transform_matrix"], np.float64)
    if pose.shape not in ((4, 4), (3, 4)):
        raise TargetError(f"transform_matrix has shape {pose.shape}, expected (4, 4).")
    rotation = _FLIP @ pose[:3, :3].T
    return Camera.perspective(
        [[focal_x, 0, centre[0]], [0, focal_y, centre[1]], [0, 0, 1]],
        rotation,
        -rotation @ pose[:3, 3],
        (height, width),
    )


def _size(image: Path) -> tuple[int, int]:
    # Files that Blender writes leave out the suffix of the images.
    for path in (image, image.with_name(image.name + ".png")):
        if path.is_file():
            with opened_image(path) as opened:
                return opened.size
    raise TargetError(f"w and h are missing, and so is the image {image}.")
