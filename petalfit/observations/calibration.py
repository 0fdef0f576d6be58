"""One camera as JSON: petalfit's own, that of OpenCV's calibration, or K, R and t by other names."""

from __future__ import annotations

from typing import Any

import numpy as np

from petalfit.observations.camera import Camera
from petalfit.observations.errors import TargetError

_MATRIX = ("K", "camera_matrix", "cameraMatrix", "intrinsic_matrix", "intrinsics", "mtx")
_DISTORTION = (
    "distortion",
    "dist_coeff",
    "dist_coeffs",
    "distCoeffs",
    "distortion_coefficients",
    "dist",
)
_ROTATION = ("rotation", "R", "rotation_matrix", "rvec", "rvecs")
_TRANSLATION = ("translation", "t", "T", "tvec", "tvecs")
_WIDTH, _HEIGHT = ("image_width", "width", "w"), ("image_height", "height", "h")
_SIZE = ("image_size", "resolution", "size")  # width and height
_OWN = ("matrix", "pixels_per_unit")


def camera_from(content: Any) -> Camera:
    """The camera that JSON describes.

    Raises:
        TargetError: It describes none.
    """
    if not isinstance(content, dict):
        raise TargetError(
            f"this is no camera but {type(content).__name__}; expected K, rotation, translation and "
            "shape."
        )
    if any(name in content for name in _OWN) or {"K", "rotation", "shape"} <= set(content):
        return Camera.from_json(content)
    matrix = _first(content, _MATRIX)
    if matrix is None:
        return Camera.from_json(content)  # which says what is missing
    rotation, translation = _first(content, _ROTATION), _first(content, _TRANSLATION)
    if rotation is None or translation is None:
        raise TargetError(
            "this calibration has no pose of the camera; expected a rotation (R or rvec) and a "
            "translation (t or tvec) besides K."
        )
    distortion = _array(_first(content, _DISTORTION) or [], "distortion").ravel()
    return Camera.perspective(
        _array(matrix, "K"),
        _rotation(_array(rotation, "rotation")),
        _array(translation, "translation").ravel(),
        _shape(content),
        distortion=tuple(map(float, distortion)),
        fisheye=content.get("fisheye") is True,
    )


def _first(content: dict[str, Any], names: tuple[str, ...]) -> Any:
    return next((content[name] for name in names if name in content), None)


def _array(value: Any, name: str) -> np.ndarray:
    """Numbers, also as OpenCV writes a matrix: its rows, columns and data."""
    if isinstance(value, dict) and "data" in value:
        value = np.reshape(value["data"], (int(value["rows"]), int(value["cols"])))
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TargetError(f"{name} must be numbers.") from None


def _rotation(value: np.ndarray) -> np.ndarray:
    """The matrix of a rotation, also of a vector about which it turns by its length in radians."""
    from scipy.spatial.transform import Rotation

    if value.size != 3:
        return value
    if not np.isfinite(value).all():
        raise TargetError("the rotation has a NaN or an infinite number.")
    return Rotation.from_rotvec(value.ravel()).as_matrix()


def _shape(content: dict[str, Any]) -> tuple[int, int]:
    if "shape" in content:
        rows, columns = content["shape"]
        return rows, columns
    width, height = _first(content, _WIDTH), _first(content, _HEIGHT)
    if width is None or height is None:
        size = _first(content, _SIZE)
        if size is None:
            raise TargetError(
                "the size of the image is missing; expected image_width and image_height, or shape "
                "(rows, columns)."
            )
        width, height = size
    return int(height), int(width)
