"""Cameras: how points in space become places in an image. OpenCV's conventions throughout.

x runs right, y down and z forward; pixel (row i, column j) covers [j, j + 1) × [i, i + 1), with its
centre at (j + ½, i + ½).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from petalfit.observations.errors import TargetError
from petalfit.observations.validation import ArrayLike

# An image of more pixels is taken for a mistake.
LARGEST_SIDE = 32768
_ORTHONORMAL = 1e-5  # what rotations that were written with six digits keep


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Camera:
    """An orthographic or a perspective camera, made by `orthographic`, `perspective` or `look_at`.

    Attributes:
        matrix: (3, 4), from homogeneous places in space to homogeneous places in the image, in
            pixels; its last row is (0, 0, 0, 1) for an orthographic camera.
        rotation: (3, 3), from the world's frame to the camera's: X_camera = rotation X + translation.
        translation: (3,), in the world's unit of length; the third is 0 for an orthographic camera.
        shape: Rows and columns of the image.
    """

    matrix: Float64[np.ndarray, "3 4"]
    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, "3"]
    shape: tuple[int, int]

    def __init__(self, **fields: Any) -> None:
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        kind = "orthographic" if self.is_orthographic else "perspective"
        rows, columns = self.shape
        return f"Camera({kind}, {rows} × {columns} pixels)"

    @property
    def is_orthographic(self) -> bool:
        """Whether rays are parallel."""
        return bool(self.matrix[2, 3] == 1 and not self.matrix[2, :3].any())

    @classmethod
    def orthographic(
        cls,
        rotation: ArrayLike,
        pixels_per_unit: float,
        centre: ArrayLike,
        shape: tuple[int, int],
    ) -> Camera:
        """A camera with parallel rays: X is seen at pixels_per_unit · (R X)_xy + centre.

        Args:
            rotation: R, (3, 3), from the world's frame to the camera's.
            pixels_per_unit: Pixels to one unit of length, positive.
            centre: (x, y) in pixels, where the world's origin is seen.
            shape: Rows and columns of the image.

        Raises:
            TargetError: An argument is no such thing.
        """
        rotation = _valid_rotation(rotation)
        centre = _finite(centre, (2,), "centre")
        if not (np.isfinite(pixels_per_unit) and pixels_per_unit > 0):
            raise TargetError(
                f"pixels_per_unit is {pixels_per_unit}; expected a positive number of pixels."
            )
        matrix = np.zeros((3, 4))
        matrix[:2, :3] = pixels_per_unit * rotation[:2]
        matrix[:2, 3] = centre
        matrix[2, 3] = 1
        translation = np.append(centre / pixels_per_unit, 0.0)
        return cls(
            matrix=matrix, rotation=rotation, translation=translation, shape=_valid_shape(shape)
        )

    @classmethod
    def perspective(
        cls,
        K: ArrayLike,
        rotation: ArrayLike,
        translation: ArrayLike,
        shape: tuple[int, int],
    ) -> Camera:
        """A pinhole camera: X is seen at the first two of K (R X + t) divided by the third.

        Args:
            K: Intrinsics, (3, 3): [[f_x, skew, c_x], [0, f_y, c_y], [0, 0, 1]] in pixels.
            rotation: R, (3, 3), from the world's frame to the camera's.
            translation: t, (3,), in the world's unit of length.
            shape: Rows and columns of the image.

        Raises:
            TargetError: An argument is no such thing.
        """
        intrinsics = _finite(K, (3, 3), "K")
        upper = not intrinsics[np.tril_indices(3, -1)].any() and intrinsics[2, 2] != 0
        if upper:
            intrinsics = intrinsics / intrinsics[2, 2]
        if not (upper and intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0):
            raise TargetError(
                "K is singular or no intrinsic matrix; expected [[f_x, skew, c_x], [0, f_y, c_y], "
                f"[0, 0, 1]] with positive focal lengths in pixels, received {intrinsics.tolist()}."
            )
        rotation = _valid_rotation(rotation)
        translation = _finite(translation, (3,), "translation")
        matrix = intrinsics @ np.column_stack([rotation, translation])
        return cls(
            matrix=matrix, rotation=rotation, translation=translation, shape=_valid_shape(shape)
        )

    @classmethod
    def look_at(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        shape: tuple[int, int],
        *,
        up: ArrayLike = (0.0, 1.0, 0.0),
        field_of_view: float = 0.7,
        pixels_per_unit: float | None = None,
    ) -> Camera:
        """A camera at `eye` with `target` in the middle of its image.

        Args:
            eye: Where it stands, (3,). For an orthographic camera only the direction counts.
            target: What it looks at, (3,).
            shape: Rows and columns of the image.
            up: What is up in the image, (3,), not along the line of sight.
            field_of_view: Angle from the left to the right edge, in radians, below π.
            pixels_per_unit: If given, the camera is orthographic with this scale.

        Raises:
            TargetError: An argument is no such thing.
        """
        eye, target = _finite(eye, (3,), "eye"), _finite(target, (3,), "target")
        forward, up = target - eye, _finite(up, (3,), "up")
        right = np.cross(forward, up)
        if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
            raise TargetError(
                "eye and target coincide, or up lies along the line of sight; give another up."
            )
        axes = np.stack([right, np.cross(forward, right), forward])
        rotation = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        rows, columns = _valid_shape(shape)
        middle = np.array([0.5 * columns, 0.5 * rows])
        if pixels_per_unit is not None:
            centre = middle - pixels_per_unit * (rotation @ target)[:2]
            return cls.orthographic(rotation, pixels_per_unit, centre, shape)
        if not 0 < field_of_view < np.pi:
            raise TargetError(
                f"field_of_view is {field_of_view}; expected an angle in radians between 0 and π."
            )
        focal = 0.5 * columns / np.tan(0.5 * field_of_view)
        intrinsics = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
        return cls.perspective(intrinsics, rotation, -rotation @ eye, shape)

    def to_json(self) -> dict[str, Any]:
        """All that it is, for `from_json`."""
        arrays = {name: getattr(self, name).tolist() for name in ("matrix", "rotation")}
        return arrays | {"translation": self.translation.tolist(), "shape": list(self.shape)}

    @classmethod
    def from_json(cls, content: Any) -> Camera:
        """A camera from its JSON: what `to_json` made, or the arguments of a constructor.

        With `pixels_per_unit` these are `orthographic`'s, with `K` they are `perspective`'s.

        Raises:
            TargetError: It is no camera.
        """
        try:
            fields = dict(content)
            fields["shape"] = tuple(fields["shape"])
            if "pixels_per_unit" in fields:
                return cls.orthographic(**fields)
            if "K" in fields:
                return cls.perspective(**fields)
            return cls(
                matrix=_finite(fields["matrix"], (3, 4), "matrix"),
                rotation=_valid_rotation(fields["rotation"], exact=True),
                translation=_finite(fields["translation"], (3,), "translation"),
                shape=_valid_shape(fields["shape"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, TargetError):
                raise
            raise TargetError(
                f"this is no camera ({error}); expected rotation, pixels_per_unit, centre and shape, or "
                "K, rotation, translation and shape."
            ) from None

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 2"]:
        """Where points are seen, (x, y) in pixels; meaningless for points that are not in front."""
        seen = points @ self.matrix[:, :3].T + self.matrix[:, 3]
        return seen[..., :2] / seen[..., 2:]

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        """Distance along the line of sight, in the world's unit of length.

        From the eye of a perspective camera, positive in front of it; for an orthographic camera from
        the plane through the world's origin.
        """
        return points @ self.rotation[2] + self.translation[2]


def _finite(value: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape:
        raise TargetError(f"{name} must be numbers of shape {shape}; received {value!r}.")
    if not np.isfinite(array).all():
        raise TargetError(f"{name} has a NaN or an infinite number.")
    return array


def _valid_rotation(rotation: ArrayLike, *, exact: bool = False) -> np.ndarray:
    array = _finite(rotation, (3, 3), "rotation")
    error = np.abs(array @ array.T - np.eye(3)).max()
    if error > _ORTHONORMAL:
        raise TargetError(
            f"rotation is not orthonormal: R Rᵀ differs from the identity by {error:.2g}; a scale "
            "belongs into pixels_per_unit or K."
        )
    if np.linalg.det(array) < 0:
        raise TargetError(
            "rotation mirrors: its determinant is −1, expected +1. From a convention with y up or z "
            "backwards, change the sign of two axes, not of one."
        )
    if exact:  # by an earlier call
        return array
    u, _, v = np.linalg.svd(array)
    return u @ v


def _valid_shape(shape: tuple[int, int]) -> tuple[int, int]:
    sides = [*shape] if isinstance(shape, tuple | list) else []
    whole = [isinstance(side, int | np.integer) and 0 < side <= LARGEST_SIDE for side in sides]
    if len(sides) != 2 or not all(whole):
        raise TargetError(
            f"shape must be (rows, columns), whole numbers from 1 to {LARGEST_SIDE}; received {shape!r}."
        )
    return int(sides[0]), int(sides[1])
