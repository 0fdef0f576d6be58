"""Camera files: one camera as JSON, a NeRF tool's `transforms.json` (instant-ngp, nerfstudio), COLMAP."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from petalfit.observations.calibration import camera_from
from petalfit.observations.camera import Camera
from petalfit.observations.colmap import is_colmap, read_colmap
from petalfit.observations.errors import TargetError
from petalfit.observations.frames import Frame, reading_cameras
from petalfit.observations.images import image_size

# Cameras of NeRF tools look along −z with y up; ours look along +z with y down.
_FLIP = np.diag([1.0, -1.0, -1.0])
_TRANSFORMS = "transforms.json"
_LARGEST = 1e12  # a larger number is a mistake


def read_transforms(path: str | os.PathLike[str]) -> dict[str, Camera]:
    """Reads the cameras of a `transforms.json`, one for each image, in the order of the file.

    The intrinsics may stand in each frame or at the top of the file: f_x and f_y in pixels or a
    horizontal angle, the size of the image, and coefficients of distortion. A missing size is read from
    the image itself.

    Args:
        path: The path of the JSON file. Images are looked for in the same folder.

    Returns:
        A dictionary from the paths of the images, as the file gives them, to their cameras.

    Raises:
        TargetError: The file cannot be read, or has another format.
    """
    with reading_cameras(Path(path)):
        return {frame.image: frame.camera for frame in _frames(_json(Path(path)), Path(path))}


def read_cameras(path: str | os.PathLike[str]) -> Camera | dict[str, Camera]:
    """Reads one camera, or the cameras of many images by the paths of the images.

    Args:
        path: The path of a JSON file with one camera (see `Camera.from_json`; also K, R and t, or a
            calibration by OpenCV), of a `transforms.json`, or of a model of COLMAP: its folder, or one of
            its files.

    Raises:
        TargetError: The file cannot be read, or has another format.
    """
    found = read_frames(path)
    return found if isinstance(found, Camera) else {frame.image: frame.camera for frame in found}


def read_frames(path: str | os.PathLike[str]) -> Camera | list[Frame]:
    """Reads one camera, or the images of a reconstruction; see `read_cameras`.

    Raises:
        TargetError: The file cannot be read, or has another format.
    """
    path = Path(path)
    with reading_cameras(path):
        if path.is_dir() and (path / _TRANSFORMS).is_file():
            path = path / _TRANSFORMS
        elif is_colmap(path):
            return read_colmap(path)
        elif path.is_dir():
            raise TargetError(
                f"it is a folder without {_TRANSFORMS} and without a model of COLMAP."
            )
        content = _json(path)
        if isinstance(content, dict) and "frames" in content:
            return _frames(content, path)
        return camera_from(content)


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8-sig"))


def _frames(content: Any, path: Path) -> list[Frame]:
    frames = []
    for frame in content["frames"]:
        name, mask = frame["file_path"], frame.get("mask_path")
        if not (isinstance(name, str) and isinstance(mask, str | None)):
            raise TargetError("file_path or mask_path of a frame is no text.")
        frames.append(Frame(name, _camera(content | frame, path.parent / name), mask))
    if not frames:
        raise TargetError("there are no frames.")
    return frames


def _camera(fields: dict[str, Any], image: Path) -> Camera:
    if "w" in fields and "h" in fields:
        width, height = int(fields["w"]), int(fields["h"])
    else:
        width, height = _size(image)
    if "fl_x" in fields:
        focal_x = float(fields["fl_x"])
        focal_y = float(fields.get("fl_y", focal_x))
    else:
        angle = float(fields["camera_angle_x"])
        if not 1e-6 < angle < math.pi:
            raise TargetError(f"camera_angle_x is {angle}; expected radians between 0 and π.")
        focal_x = focal_y = 0.5 * width / math.tan(0.5 * angle)
    centre = float(fields.get("cx", 0.5 * width)), float(fields.get("cy", 0.5 * height))
    try:
        pose = np.array(fields["transform_matrix"], np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TargetError("transform_matrix must be numbers of shape (4, 4).") from None
    if pose.shape not in ((4, 4), (3, 4)):
        raise TargetError(f"transform_matrix has shape {pose.shape}, expected (4, 4).")
    if not np.isfinite(pose).all() or np.abs(pose).max() > _LARGEST:
        raise TargetError("transform_matrix has a number that is NaN, infinite or too large.")
    rotation = _FLIP @ pose[:3, :3].T
    distortion, fisheye = _distortion(fields)
    return Camera.perspective(
        [[focal_x, 0, centre[0]], [0, focal_y, centre[1]], [0, 0, 1]],
        rotation,
        -rotation @ pose[:3, 3],
        (height, width),
        distortion=distortion,
        fisheye=fisheye,
    )


def _distortion(fields: dict[str, Any]) -> tuple[tuple[float, ...], bool]:
    """The coefficients in the order of OpenCV, and whether the lens is a fisheye."""
    model = str(fields.get("camera_model", "")).upper()
    fisheye = "FISHEYE" in model
    if any(word in model for word in ("EQUIRECT", "ORTHO", "VR180", "OMNI", "FISHEYE624")):
        raise TargetError(f"the camera model {model} is not known; undistort the images first.")
    order = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    others = {"k3", "k4", "k5", "k6", "p1", "p2"} - set(order)
    left = sorted(name for name in others if float(fields.get(name) or 0))
    if left:
        raise TargetError(
            f"the lens distortion {', '.join(left)} of {model or 'this camera'} is not known; undistort "
            "the images first."
        )
    return tuple(float(fields.get(name) or 0) for name in order), fisheye


def _size(image: Path) -> tuple[int, int]:
    # Files that Blender writes leave out the suffix of the images.
    for path in (image, image.with_name(image.name + ".png")):
        if path.is_file():
            return image_size(path)
    raise TargetError(f"w and h are missing, and so is the image {image}.")
