"""Models of COLMAP: cameras and images, as text or binary (colmap.github.io/format.html)."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from petalfit.observations.camera import Camera
from petalfit.observations.errors import TargetError
from petalfit.observations.frames import Frame

# For each model its number in binary files, its focal lengths, its coefficients in OpenCV's order, and
# whether it is a fisheye; after the focal lengths comes the principal point.
_MODELS = {
    "SIMPLE_PINHOLE": (0, 1, 0, False),
    "PINHOLE": (1, 2, 0, False),
    "SIMPLE_RADIAL": (2, 1, 1, False),
    "RADIAL": (3, 1, 2, False),
    "OPENCV": (4, 2, 4, False),
    "OPENCV_FISHEYE": (5, 2, 4, True),
    "FULL_OPENCV": (6, 2, 8, False),
    "SIMPLE_RADIAL_FISHEYE": (8, 1, 1, True),
    "RADIAL_FISHEYE": (9, 1, 2, True),
}
_POINT_SIZE = 24  # bytes of a point in an image: x, y and the number of the point in space
_LONGEST = 10_000_000  # a larger count is damage


class _Intrinsics(NamedTuple):
    model: str
    width: int
    height: int
    params: tuple[float, ...]


class _Image(NamedTuple):
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int
    name: str


def is_colmap(path: Path) -> bool:
    """Whether this is the folder of a model, or a file of one."""
    return _folder(path) is not None


def read_colmap(path: Path) -> list[Frame]:
    """Reads the images of a model in the order of the file.

    Args:
        path: The folder of the model, or one of its files.

    Raises:
        TargetError: A camera has a model that is not known, or an image has no camera.
    """
    folder = _folder(path)
    if folder is None:
        raise TargetError("there are no cameras and images of COLMAP, as .txt or .bin.")
    if (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file():
        cameras = dict(_binary_cameras(_Bytes((folder / "cameras.bin").read_bytes())))
        images = [*_binary_images(_Bytes((folder / "images.bin").read_bytes()))]
    else:
        cameras = dict(_text_cameras((folder / "cameras.txt").read_text(encoding="utf-8")))
        images = [*_text_images((folder / "images.txt").read_text(encoding="utf-8"))]
    if not images:
        raise TargetError("the model has no images.")
    return [Frame(image.name, _camera(image, cameras[image.camera])) for image in images]


def _folder(path: Path) -> Path | None:
    for folder in (path, path / "sparse" / "0", path / "sparse", path / "colmap" / "sparse" / "0"):
        for suffix in (".bin", ".txt"):
            if all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")):
                return folder
    is_part = path.stem in ("cameras", "images", "points3D") and path.suffix in (".txt", ".bin")
    return _folder(path.parent) if is_part and path.is_file() else None


def _camera(image: _Image, known: _Intrinsics) -> Camera:
    from scipy.spatial.transform import Rotation

    if known.model not in _MODELS:
        raise TargetError(
            f"the camera model {known.model} is not known; known are {', '.join(_MODELS)}. Undistort the "
            "images with COLMAP (image_undistorter) first."
        )
    _, focals, count, fisheye = _MODELS[known.model]
    if len(known.params) != focals + 2 + count:
        raise TargetError(
            f"a camera {known.model} has {focals + 2 + count} parameters, not {len(known.params)}."
        )
    focal_x, focal_y = known.params[0], known.params[focals - 1]
    centre_x, centre_y = known.params[focals : focals + 2]
    # A unit quaternion; other programs may round it.
    if not 0.5 < math.hypot(*image.quaternion) < 2:
        raise TargetError(f"the rotation of {image.name} is no unit quaternion; export it again.")
    rotation = Rotation.from_quat(image.quaternion, scalar_first=True).as_matrix()
    return Camera.perspective(
        [[focal_x, 0, centre_x], [0, focal_y, centre_y], [0, 0, 1]],
        rotation,
        image.translation,
        (known.height, known.width),
        distortion=known.params[focals + 2 :],
        fisheye=fisheye,
    )


def _text_cameras(text: str) -> Iterator[tuple[int, _Intrinsics]]:
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            number, model, width, height, *params = line.split()
            yield int(number), _Intrinsics(model, int(width), int(height), _floats(params))


def _text_images(text: str) -> Iterator[_Image]:
    """Every image has two lines, of which the second, with its points, may be empty."""
    lines = iter(text.splitlines())
    for line in lines:
        if line.strip() and not line.startswith("#"):
            _, *numbers, camera, name = line.split(maxsplit=9)
            values = _floats(numbers)
            yield _Image(values[:4], values[4:], int(camera), name.strip())
            next(lines, None)


def _floats(texts: list[str]) -> tuple[float, ...]:
    return tuple(map(float, texts))


class _Bytes:
    """Numbers and names in the bytes of a file, one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._place = content, 0

    def read(self, kinds: str) -> tuple:
        size = struct.calcsize("<" + kinds)
        if self._place + size > len(self._content):
            raise TargetError("the file is cut short.")
        values = struct.unpack_from("<" + kinds, self._content, self._place)
        self._place += size
        return values

    def count(self) -> int:
        (count,) = self.read("Q")
        if count > _LONGEST:
            raise TargetError(f"the file is damaged: it says that it has {count} parts.")
        return count

    def name(self) -> str:
        end = self._content.find(b"\0", self._place)
        if end < 0:
            raise TargetError("the file is cut short.")
        text = self._content[self._place : end].decode("utf-8")
        self._place = end + 1
        return text

    def skip(self, size: int) -> None:
        self._place += size


def _binary_cameras(content: _Bytes) -> Iterator[tuple[int, _Intrinsics]]:
    names = {
        number: (name, focals + 2 + count) for name, (number, focals, count, _) in _MODELS.items()
    }
    for _ in range(content.count()):
        number, model, width, height = content.read("iiQQ")
        if model not in names:
            raise TargetError(f"the camera model number {model} is not known; undistort first.")
        name, count = names[model]
        yield number, _Intrinsics(name, width, height, content.read(f"{count}d"))


def _binary_images(content: _Bytes) -> Iterator[_Image]:
    for _ in range(content.count()):
        _, *values, camera = content.read("i7di")
        name = content.name()
        content.skip(_POINT_SIZE * content.count())
        yield _Image(tuple(values[:4]), tuple(values[4:]), camera, name)
