"""Opening image files: masks, photos and textures share one way and its errors."""

from __future__ import annotations

import os
import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from petalfit.observations.errors import TargetError, naming
from petalfit.observations.memory import available_memory

if TYPE_CHECKING:
    from PIL.Image import Image


_HEIC = (".heic", ".heif")
IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".gif", ".webp", ".jpg", ".jpeg", *_HEIC)
# Memory that reading and checking a mask or a photo takes, in bytes a pixel.
_BYTES_PER_PIXEL = 32
_LOCK = threading.Lock()
# What Pillow raises for damaged files, besides its own errors.
_DAMAGED = (OSError, ValueError, SyntaxError, EOFError, IndexError, KeyError, OverflowError, TypeError,
            AttributeError, AssertionError, ZeroDivisionError, struct.error, zlib.error)  # fmt: skip


@contextmanager
def opened_image(path: str | os.PathLike[str]) -> Iterator[Image]:
    """Yields an open image; its pixels must be read within the block, which does nothing else.

    Raises:
        TargetError: The file does not exist, cannot be read as an image, or is too large for the memory
            of this machine.
    """
    _prepare(Path(path))
    try:
        # Pillow warns of damaged parts that it can do without, and of sizes that are checked here.
        with warnings.catch_warnings(), naming(path):
            warnings.simplefilter("ignore")
            with _opened(path) as image:
                _check_size(image)
                yield image
    except FileNotFoundError:
        raise TargetError(f"{os.fspath(path)} does not exist; check the path.") from None
    except TargetError:
        raise
    except _DAMAGED as error:
        reason = str(error) or type(error).__name__
        raise TargetError(f"{os.fspath(path)} cannot be read as an image: {reason}") from None


def upright(image: Image) -> Image:
    """The image as it is to be seen, whichever way the camera was held (EXIF orientation)."""
    from PIL import ImageOps

    return ImageOps.exif_transpose(image)


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """The width and the height of an image, from its header and its orientation.

    Raises:
        TargetError: The file does not exist, or cannot be read as an image.
    """
    with opened_image(path) as image:
        width, height = image.size
        turned = image.getexif().get(_ORIENTATION, 1) in _ON_ITS_SIDE
    return (height, width) if turned else (width, height)


_ORIENTATION, _ON_ITS_SIDE = 0x0112, (5, 6, 7, 8)


def _opened(path: str | os.PathLike[str]) -> Image:
    """Opens an image of any size: what fits depends on the machine, and not on Pillow's own limit."""
    from PIL import Image as images

    with _LOCK:
        limit = images.MAX_IMAGE_PIXELS
        images.MAX_IMAGE_PIXELS = None
        try:
            return images.open(path)
        finally:
            images.MAX_IMAGE_PIXELS = limit


def _prepare(path: Path) -> None:
    """Makes Pillow read HEIC, the format of telephones, if this is such a file."""
    if path.suffix.lower() not in _HEIC or not path.is_file():
        return
    try:
        from pillow_heif import register_heif_opener
    except ImportError:
        raise TargetError(
            f"{path}: HEIC is read with pip install 'petalfit[formats]'; or save it as JPEG or PNG."
        ) from None
    register_heif_opener()


def _check_size(image: Image) -> None:
    needed = image.width * image.height * _BYTES_PER_PIXEL
    left = available_memory()
    if needed > left:
        raise TargetError(
            f"it has {image.width} × {image.height} pixels, which take {needed / 1e9:.3g} GB of memory, "
            f"and {left / 1e9:.3g} GB are available. Make it smaller."
        )
