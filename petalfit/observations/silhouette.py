"""Silhouettes: masks of the part of an image that a petal covers."""

from __future__ import annotations

import base64
import math
import os
import zlib
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float64

from petalfit.observations.atomic import atomic_path
from petalfit.observations.camera import Camera
from petalfit.observations.coverage import coverage, read_coverage
from petalfit.observations.errors import TargetError, naming
from petalfit.observations.mask_pieces import petal_alone
from petalfit.observations.observation import AbstractObservation
from petalfit.observations.undistortion import undistorted
from petalfit.observations.validation import ArrayLike

# A mask with fewer covered pixels does not show a shape.
_FEWEST = 32


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Silhouette(AbstractObservation):
    """A mask of a petal, optionally with the camera that took the image.

    The arrays are checked, copied to float64 and made read-only.

    Args:
        mask: (H, W), bool, or coverage from 0 to 1: the fraction of each pixel that the petal covers. Of
            whole numbers there may be any two, of which the higher is the petal's. Small other pieces
            are left out.
        camera: The camera that took the image; None stands for an orthographic front view of unknown
            scale and position. The camera of a larger image is scaled; distortion by a lens is removed
            from the mask and from the camera.
        weights: (H, W), at least 0: how far the mask is trusted at each pixel; for instance 0 where
            another object hides the petal. The mask is never trusted along the border of the image,
            because the petal may go on beyond it.

    Raises:
        TargetError: The mask cannot be used; the message says why and what to do.
    """

    kind: ClassVar[str] = "mask"
    unit: ClassVar[str] = "px"
    mask: Float64[np.ndarray, "h w"]
    camera: Camera | None
    weights: Float64[np.ndarray, "h w"] | None

    def __init__(
        self,
        mask: ArrayLike,
        camera: Camera | None = None,
        weights: ArrayLike | None = None,
    ) -> None:
        mask = _valid_mask(mask)
        if camera is not None:
            camera = _of_the_mask(camera, mask.shape)
        if weights is not None:
            weights = np.array(weights, np.float64)
            if weights.shape != mask.shape:
                raise TargetError(
                    f"weights have shape {weights.shape}, expected the mask's {mask.shape}."
                )
            if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
                raise TargetError("weights must be finite, at least 0, and not 0 everywhere.")
        if camera is not None and camera.lens is not None:
            mask, weights, camera = undistorted(mask, weights, camera)
        mask, notes = petal_alone(mask, None if weights is None else weights > 0)
        fields = {"mask": mask, "camera": camera, "weights": weights, "notes": notes}
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        rows, columns = self.mask.shape
        kind = "binary" if self.is_binary else "coverage"
        extras = [name for name in ("camera", "weights") if getattr(self, name) is not None]
        return f"Silhouette({', '.join([f'{rows} × {columns} pixels', kind, *extras])})"

    @property
    def is_binary(self) -> bool:
        """Whether every pixel is covered completely or not at all."""
        return bool(np.isin(self.mask, (0.0, 1.0)).all())

    @property
    def area(self) -> float:
        """The covered area, in square pixels."""
        return float(self.mask.sum())

    @property
    def extent(self) -> Float64[np.ndarray, "2"]:
        """The width and the height of the image, in pixels; (2,)."""
        return np.array(self.mask.shape[::-1], np.float64)

    @property
    def size(self) -> float:
        rows, columns = np.nonzero(self.mask >= 0.5)
        return math.hypot(np.ptp(rows), np.ptp(columns))

    @property
    def described(self) -> str:
        rows, columns = self.mask.shape
        return f"a mask of {columns} × {rows} pixels"

    def arrays(self) -> tuple[dict[str, Any], list[Float64[np.ndarray, "..."] | None]]:
        camera = None if self.camera is None else self.camera.to_json()
        return {"camera": camera}, [self.mask, self.weights]

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "shape": list(self.mask.shape),
            "mask": _packed(self.mask),
            "weights": None if self.weights is None else _packed(self.weights),
            "camera": None if self.camera is None else self.camera.to_json(),
        }

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Silhouette:
        shape = tuple(content["shape"])
        weights, camera = content["weights"], content["camera"]
        return cls(
            _unpacked(content["mask"], shape),
            None if camera is None else Camera.from_json(camera),
            None if weights is None else _unpacked(weights, shape),
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str], camera: Camera | None = None) -> Silhouette:
        """Reads the mask from an image: its alpha channel if it has one, otherwise its values.

        Of two values or colours, the higher one, or the one that is not the border's, is the petal's;
        values between them are coverage.

        Args:
            path: The path of the image: PNG, TIFF or any other format that Pillow reads, or an array of
                shape (H, W) in a `.npy` file.
            camera: The camera that took the image.

        Raises:
            TargetError: The file cannot be read, or is a photo instead of a mask.
        """
        with naming(path):
            return cls(read_coverage(path), camera)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a grey PNG of 8 bits, black for the background; completely or not at all."""
        write_mask(path, self.mask)


def write_mask(
    path: str | os.PathLike[str], mask: Bool[np.ndarray, "h w"] | Float[np.ndarray, "h w"]
) -> None:
    """Writes a mask as a grey PNG of 8 bits, black for the background; completely or not at all."""
    from PIL import Image

    grey = mask * np.uint8(255) if mask.dtype == bool else np.rint(255 * mask).astype(np.uint8)
    with atomic_path(path) as temporary:
        Image.fromarray(grey).save(temporary, format="PNG")


def _of_the_mask(camera: Camera, shape: tuple[int, int]) -> Camera:
    """The camera of a mask, which may be smaller than the image of its camera.

    Raises:
        TargetError: The mask is no smaller copy of the image.
    """
    if camera.shape == shape:
        return camera
    (rows, columns), (of_rows, of_columns) = shape, camera.shape
    scale = math.sqrt(rows * columns / (of_rows * of_columns))
    is_smaller = (
        scale < 1 and max(abs(rows - scale * of_rows), abs(columns - scale * of_columns)) < 1
    )
    if is_smaller:
        return camera.resized(shape)
    hint = "they must agree, or the mask be a smaller copy of the image."
    if shape == camera.shape[::-1]:
        hint = "one of them lies on its side: save the mask as the image of the camera is stored."
    raise TargetError(
        f"the mask has {rows} × {columns} pixels and its camera {of_rows} × {of_columns} "
        f"(rows × columns); {hint}"
    )


def _valid_mask(mask: ArrayLike) -> np.ndarray:
    array = np.asarray(mask)
    if array.ndim == 3:
        raise TargetError(
            f"the mask has shape {array.shape}, which looks like a photo; expected (H, W). "
            "`petalfit mask PHOTO -o MASK.png` makes a mask of a photo."
        )
    if array.ndim != 2 or array.dtype.kind not in "biuf":
        raise TargetError(
            f"the mask has shape {array.shape} and type {array.dtype}, expected (H, W), bool or "
            "coverage from 0 to 1."
        )
    if array.dtype.kind in "iu" and array.size and np.isin(array, (array.min(), array.max())).all():
        array = coverage(array)
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise TargetError("the mask has a NaN or an infinite value.")
    low, high = array.min(initial=0.0), array.max(initial=0.0)
    if low < 0 or high > 1:
        raise TargetError(
            f"the mask has values from {low:g} to {high:g}, expected 0 to 1; divide 8-bit grey values "
            "by 255."
        )
    if array.sum() < _FEWEST:
        raise TargetError(
            f"the mask is blank: {array.sum():.0f} pixels are covered, and at least {_FEWEST} are "
            "needed. Is the petal 1 and the background 0?"
        )
    if (1 - array).sum() < 1:
        raise TargetError(
            "the mask is full: it has no background, hence no outline. Is the petal 1 and the "
            "background 0?"
        )
    return array


def _packed(array: np.ndarray) -> str:
    """An array as text: bytes if all are multiples of 1/255, else doubles; deflated, in base 64."""
    eight = np.rint(255 * array)
    exact = bool(((eight / 255) == array).all() and (eight <= 255).all())
    content = eight.astype(np.uint8) if exact else array.astype("<f8")
    data = base64.b64encode(zlib.compress(content.tobytes(), 6)).decode("ascii")
    return f"{'u1' if exact else 'f8'}:{data}"


def _unpacked(text: str, shape: tuple[int, ...]) -> np.ndarray:
    kind, _, data = text.partition(":")
    size = math.prod(shape) * (1 if kind == "u1" else 8)
    # A file of a few bytes could unpack to any size: no more is unpacked than the shape needs.
    content = zlib.decompressobj().decompress(base64.b64decode(data), size + 1)
    if kind == "u1":
        return np.frombuffer(content, np.uint8).reshape(shape) / 255
    return np.frombuffer(content, "<f8").reshape(shape).astype(np.float64)
