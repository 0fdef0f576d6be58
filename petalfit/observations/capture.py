"""The folder of a capture: images or masks of one petal, with the cameras of a reconstruction."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from petalfit.observations.camera import Camera
from petalfit.observations.errors import TargetError
from petalfit.observations.frames import Frame, frame_of
from petalfit.observations.images import IMAGE_SUFFIXES
from petalfit.observations.photo import read_photo, segment
from petalfit.observations.silhouette import Silhouette
from petalfit.observations.transforms import read_frames

_MASKS, _IMAGES = ("masks", "mask"), ("", "images", "input")


def read_capture(folder: str | os.PathLike[str]) -> list[Silhouette]:
    """Reads the masks of a capture, each with its camera, in the order of the cameras.

    The folder has a `transforms.json` or a model of COLMAP (also in `sparse/0`). The mask of an image is
    its `mask_path`, or of the same name in the folder `masks`. If no image has such a mask, the images
    themselves are taken: those that are masks, the alpha channel of others, and photos are masked as
    `petalfit mask` does.

    Args:
        folder: The path of the folder.

    Raises:
        TargetError: There are no cameras, or no masks or images for them; or one cannot be used.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise TargetError(f"{folder} is no folder; check the path.")
    frames = read_frames(folder)
    if isinstance(frames, Camera):
        raise TargetError(f"{folder} has one camera and no images with cameras.")
    given = _masks(folder, frames)
    if given:
        return [Silhouette.load(path, frame.camera) for frame, path in given]
    found = [(frame, _image(folder, frame)) for frame in frames]
    images = [_of_image(path, frame) for frame, path in found if path is not None]
    if not images:
        raise TargetError(
            f"{folder} has cameras of {len(frames)} images, such as {frames[0].image}, and neither these "
            "images nor masks of them in a folder masks."
        )
    photos = [silhouette for silhouette, is_photo in images if is_photo]
    if photos:
        note = (
            f"Masks were found in {len(photos)} of the photos; `petalfit mask` shows what it finds."
        )
        object.__setattr__(photos[0], "notes", (note, *photos[0].notes))
    return [silhouette for silhouette, _ in images]


def _masks(folder: Path, frames: list[Frame]) -> list[tuple[Frame, Path]]:
    """The images that have a mask of their own, with the path of the mask."""
    files = [
        path
        for name in _MASKS
        if (folder / name).is_dir()
        for path in sorted((folder / name).rglob("*"))
        if path.suffix.lower() in (*IMAGE_SUFFIXES, ".npy")
    ]
    beside: dict[Frame, Path] = {}
    for path in files:
        frame = frame_of(path.relative_to(folder), frames, folder)
        if frame is not None:
            beside.setdefault(frame, path)
    found = []
    for frame in frames:
        given = None if frame.mask is None else folder / frame.mask
        path = given if given is not None and given.is_file() else beside.get(frame)
        if path is not None:
            found.append((frame, path))
    return found


def _image(folder: Path, frame: Frame) -> Path | None:
    """The file of an image, where the cameras say or directly in a folder of images."""
    name = frame.image.replace("\\", "/")
    tried = [folder / beside / name for beside in _IMAGES]
    tried += [folder / beside / PurePosixPath(name).name for beside in _IMAGES]
    return _first_file([*tried, *(path.with_name(path.name + ".png") for path in tried)])


def _first_file(paths: Iterable[Path]) -> Path | None:
    return next((path for path in paths if path.is_file()), None)


def _of_image(path: Path, frame: Frame) -> tuple[Silhouette, bool]:
    """The mask that an image is or has, or that is found in it, and whether it is a photo."""
    try:
        return Silhouette.load(path, frame.camera), False
    except TargetError:
        photo = read_photo(path)
    try:
        return Silhouette(segment(photo), frame.camera), True
    except TargetError as error:
        raise TargetError(
            f"{path}: {error} Save masks as masks/{path.stem}.png, made by petalfit mask."
        ) from None
