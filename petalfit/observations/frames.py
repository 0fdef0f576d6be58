"""The images of a reconstruction, and which of them a mask belongs to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from petalfit.observations.camera import Camera
from petalfit.observations.errors import TargetError, naming
from petalfit.observations.images import IMAGE_SUFFIXES

_SHOWN = 6  # names in a message


class Frame(NamedTuple):
    """One image of a reconstruction.

    Attributes:
        image: The path of the image, as the file of the cameras gives it.
        camera: The camera.
        mask: The path of its mask, if the file gives one.
    """

    image: str
    camera: Camera
    mask: str | None = None


@contextmanager
def reading_cameras(path: Path) -> Iterator[None]:
    """Turns what goes wrong while a file of cameras is read into an error that names the file."""
    try:
        with naming(path):
            yield
    except TargetError:
        raise
    except FileNotFoundError as error:
        missing = error.filename or path
        raise TargetError(
            f"{path} cannot be read as cameras: there is no file {missing}."
        ) from None
    except (OSError, ValueError, RecursionError, OverflowError, ArithmeticError) as error:
        raise TargetError(f"{path} cannot be read as cameras: {error}") from None
    except (AttributeError, LookupError, TypeError) as error:
        raise TargetError(
            f"{path} is no transforms.json of a NeRF tool, no model of COLMAP and no camera ({error!r}); "
            "expected frames, each with file_path and transform_matrix, or K, rotation, translation and "
            "shape."
        ) from None


def cameras_of(masks: Sequence[Path], frames: Sequence[Frame], source: Path) -> list[Camera]:
    """The camera of each mask: that of the image whose path agrees with the mask's from the end.

    The mask of images/a.jpg may be called a.png, a.jpg.png or a.jpg, in any folder. Of several images
    with such a name, the folders decide; `mask_path` of nerfstudio, if it is given, goes first.

    Args:
        masks: The paths of the masks.
        frames: The images.
        source: The path of the file of the cameras, for messages.

    Raises:
        TargetError: A mask has no camera, or may have several.
    """
    found = [frame_of(path, frames, source) for path in masks]
    missing = [str(path) for path, frame in zip(masks, found, strict=True) if frame is None]
    if missing:
        raise TargetError(
            f"{source} has no camera for {_listed(missing)}; it has those of "
            f"{_listed([PurePosixPath(frame.image).stem for frame in frames])}."
        )
    return [frame.camera for frame in found if frame is not None]


def frame_of(mask: Path, frames: Sequence[Frame], source: Path) -> Frame | None:
    """The image of a mask; None if there is none of its name.

    Raises:
        TargetError: There are several that agree as well.
    """
    best = max(_agreement(mask, frame) for frame in frames)
    if best == (0, 0):
        return None
    found = [frame for frame in frames if _agreement(mask, frame) == best]
    if len(found) > 1:
        raise TargetError(
            f"{mask} may be the mask of {_listed([frame.image for frame in found])}, which {source} all "
            "has; put it into a folder of the same name as the folder of its image."
        )
    return found[0]


def _agreement(mask: Path, frame: Frame) -> tuple[int, int]:
    """How many parts of the paths agree, from the end: those of a mask_path, and of the image."""
    given = 0 if frame.mask is None else _parts_in_common(mask, _parts(frame.mask))
    return given, _parts_in_common(mask, _parts(frame.image))


def _parts(name: str) -> tuple[str, ...]:
    return PurePosixPath(name.replace("\\", "/")).parts


def _parts_in_common(mask: Path, other: tuple[str, ...]) -> int:
    own = Path(mask).parts
    if not own or not other or not _same_name(own[-1], other[-1]):
        return 0
    count = 1
    for one, two in zip(own[-2::-1], other[-2::-1], strict=False):
        if one != two:
            break
        count += 1
    return count


def _same_name(mask: str, image: str) -> bool:
    """Whether a.png or a.jpg.png is a mask of a.jpg, or of a, which Blender writes."""
    stem, own = PurePosixPath(mask).stem, PurePosixPath(image).stem
    is_double = PurePosixPath(stem).suffix.lower() in IMAGE_SUFFIXES
    return stem in (own, image) or (is_double and PurePosixPath(stem).stem == own)


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
