"""Cameras: the projection of points in space into an image, in the conventions of OpenCV.

x points right, y down and z forward. Pixel (row i, column j) covers [j, j + 1) × [i, i + 1); its
centre is at (j + ½, i + ½).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from petalfit.observations.errors import TargetError
from petalfit.observations.lens import Lens, lens_of
from petalfit.observations.validation import ArrayLike

# An image with more rows or columns is taken for a mistake.
LARGEST_SIDE = 32768
_SHOWN = 200  # characters of a wrong value in a message
_LARGEST = 1e12  # a larger number is a mistake, and its products overflow
_NEGLIGIBLE = 0.1  # pixels by which a lens may move every place without being a distorting one
_ORTHONORMAL = 1e-5  # tolerance of R Rᵀ = I, met by rotations that were written with six digits


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Camera:
    """An orthographic or a perspective camera, made by `orthographic`, `perspective` or `look_at`.

    Attributes:
        matrix: The (3, 4) matrix from homogeneous coordinates in space to homogeneous coordinates in
            the image, in pixels; its last row is (0, 0, 0, 1) for an orthographic camera.
        rotation: The (3, 3) rotation from the world's frame to the camera's:
            X_camera = rotation X + translation.
        translation: (3,), in the world's unit of length; its third component is 0 for an orthographic
            camera.
        shape: The numbers of rows and columns of the image.
        lens: The distortion of the photo's lens, of which the matrix knows nothing; None for a pinhole.
            A `Silhouette` undistorts its mask, so that its own camera has none.
    """

    matrix: Float64[np.ndarray, "3 4"]
    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, "3"]
    shape: tuple[int, int]
    lens: Lens | None = None

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
        """Whether the camera is orthographic: its rays are parallel."""
        return bool(self.matrix[2, 3] == 1 and not self.matrix[2, :3].any())

    @classmethod
    def orthographic(
        cls,
        rotation: ArrayLike,
        pixels_per_unit: float,
        centre: ArrayLike,
        shape: tuple[int, int],
    ) -> Camera:
        """An orthographic camera: X appears at pixels_per_unit · (R X)_xy + centre.

        Args:
            rotation: R, (3, 3), from the world's frame to the camera's.
            pixels_per_unit: The number of pixels per unit of length, positive.
            centre: The place (x, y) of the world's origin in the image, in pixels.
            shape: The numbers of rows and columns of the image.

        Raises:
            TargetError: An argument is invalid; the message says which one and why.
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
        *,
        distortion: ArrayLike = (),
        fisheye: bool = False,
    ) -> Camera:
        """A pinhole camera, or one with a lens: with y = K (R X + t), X appears at (y₁, y₂)/y₃.

        Args:
            K: The intrinsic matrix, (3, 3): [[f_x, skew, c_x], [0, f_y, c_y], [0, 0, 1]] in pixels.
            rotation: R, (3, 3), from the world's frame to the camera's.
            translation: t, (3,), in the world's unit of length.
            shape: The numbers of rows and columns of the image.
            distortion: The coefficients of the lens, (n,), in the order of OpenCV: k₁, k₂, p₁, p₂, k₃,
                k₄, k₅, k₆, or k₁ to k₄ of a fisheye. Missing ones are 0.
            fisheye: Whether the lens is a fisheye.

        Raises:
            TargetError: An argument is invalid; the message says which one and why.
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
        shape = _valid_shape(shape)
        coefficients = _finite(distortion, np.shape(np.asarray(distortion)), "distortion").ravel()
        lens = lens_of(intrinsics, coefficients, fisheye, shape, _NEGLIGIBLE)
        return cls(
            matrix=matrix, rotation=rotation, translation=translation, shape=shape, lens=lens
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
        """A camera at `eye` that shows `target` in the middle of its image.

        Args:
            eye: The place of the camera, (3,). For an orthographic camera only the direction from the
                target counts.
            target: The place that the camera looks at, (3,).
            shape: The numbers of rows and columns of the image.
            up: The direction that points up in the image, (3,); it must not lie along the line of sight.
            field_of_view: The angle from the left to the right edge of the image, in radians, below π.
            pixels_per_unit: If given, the camera is orthographic with this scale.

        Raises:
            TargetError: An argument is invalid; the message says which one and why.
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

    def pinhole(self, margin: int = 0) -> Camera:
        """The camera without the distortion of its lens, of an image with a margin on each side."""
        if self.lens is None and margin == 0:
            return self
        rows, columns = self.shape
        moved = np.eye(3)
        moved[:2, 2] = margin
        return Camera(
            matrix=moved @ self.matrix,
            rotation=self.rotation,
            translation=self.translation,
            shape=(rows + 2 * margin, columns + 2 * margin),
        )

    def resized(self, shape: tuple[int, int]) -> Camera:
        """The camera of the same image with other numbers of rows and columns.

        Raises:
            TargetError: The shape is no valid one.
        """
        rows, columns = _valid_shape(shape)
        across, down = columns / self.shape[1], rows / self.shape[0]
        lens = self.lens
        if lens is not None:
            focal = across * lens.focal[0], down * lens.focal[1]
            centre = across * lens.centre[0], down * lens.centre[1]
            lens = Lens(focal, centre, lens.coefficients, lens.fisheye)
        return Camera(
            matrix=np.diag([across, down, 1.0]) @ self.matrix,
            rotation=self.rotation,
            translation=self.translation,
            shape=(rows, columns),
            lens=lens,
        )

    def to_json(self) -> dict[str, Any]:
        """The camera as lossless JSON, for `from_json`."""
        arrays = {name: getattr(self, name).tolist() for name in ("matrix", "rotation")}
        described = arrays | {"translation": self.translation.tolist(), "shape": list(self.shape)}
        if self.lens is not None:
            described["lens"] = dataclasses.asdict(self.lens)
        return described

    @classmethod
    def from_json(cls, content: Any) -> Camera:
        """A camera from its JSON: the result of `to_json`, or the arguments of a constructor.

        An object with `pixels_per_unit` holds the arguments of `orthographic`, one with `K` those of
        `perspective`.

        Raises:
            TargetError: The content does not describe a camera.
        """
        try:
            fields = dict(content)
            fields["shape"] = _valid_shape(fields["shape"])
            if "pixels_per_unit" in fields:
                return cls.orthographic(**fields)
            if "K" in fields:
                return cls.perspective(**fields)
            return cls(
                matrix=_finite(fields["matrix"], (3, 4), "matrix"),
                rotation=_valid_rotation(fields["rotation"], exact=True),
                translation=_finite(fields["translation"], (3,), "translation"),
                shape=fields["shape"],
                lens=_lens(fields["lens"]) if fields.get("lens") else None,
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, TargetError):
                raise
            raise TargetError(
                f"this is no camera ({error}); expected rotation, pixels_per_unit, centre and shape, or "
                "K, rotation, translation and shape."
            ) from None

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 2"]:
        """Projects points into the image, (x, y) in pixels; meaningless for points behind the camera."""
        seen = points @ self.matrix[:, :3].T + self.matrix[:, 3]
        return seen[..., :2] / seen[..., 2:]

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        """The distance of points along the line of sight, in the world's unit of length.

        It is measured from the eye of a perspective camera, positive in front of it, and from the plane
        through the world's origin for an orthographic camera.
        """
        return points @ self.rotation[2] + self.translation[2]


def _finite(value: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != shape:
        received = repr(value) if len(repr(value)) <= _SHOWN else f"{repr(value)[:_SHOWN]} …"
        raise TargetError(f"{name} must be numbers of shape {shape}; received {received}.")
    if not np.isfinite(array).all():
        raise TargetError(f"{name} has a NaN or an infinite number.")
    if (np.abs(array) > _LARGEST).any():
        raise TargetError(f"{name} has a number beyond ±{_LARGEST:g}.")
    return array


def _lens(content: Any) -> Lens:
    focal, centre = (_finite(content[name], (2,), name) for name in ("focal", "centre"))
    count = 4 if content["fisheye"] is True else 8
    coefficients = _finite(content["coefficients"], (count,), "coefficients")
    return Lens(
        (float(focal[0]), float(focal[1])),
        (float(centre[0]), float(centre[1])),
        tuple(map(float, coefficients)),
        content["fisheye"] is True,
    )


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
    if exact:  # an earlier call has made it orthonormal
        return array
    u, _, v = np.linalg.svd(array)
    return u @ v


def _valid_shape(shape: object) -> tuple[int, int]:
    sides = [*shape] if isinstance(shape, tuple | list) else []
    whole = [isinstance(side, int | np.integer) and 0 < side <= LARGEST_SIDE for side in sides]
    if len(sides) != 2 or not all(whole):
        raise TargetError(
            f"shape must be (rows, columns), whole numbers from 1 to {LARGEST_SIDE}; received {shape!r}."
        )
    return int(sides[0]), int(sides[1])
