"""Opening image files: masks, photos and textures share one way and its errors."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from petalfit.observations.errors import TargetError

if TYPE_CHECKING:
    from PIL.Image import Image


# What Pillow raises for damaged files, besides its own errors.
_DAMAGED = (OSError, ValueError, SyntaxError, EOFError, IndexError, KeyError, OverflowError, TypeError,
            AttributeError, AssertionError, ZeroDivisionError, struct.error, zlib.error)  # fmt: skip
IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".gif", ".webp", ".jpg", ".jpeg")


@contextmanager
def opened_image(path: str | os.PathLike[str]) -> Iterator[Image]:
    """Yields an open image; its pixels must be read within the block.

    Raises:
        TargetError: The file does not exist, or cannot be read as an image.
    """
    from PIL import Image as images

    try:
        with images.open(path) as image:
            yield image
    except FileNotFoundError:
        raise TargetError(f"{os.fspath(path)} does not exist; check the path.") from None
    except TargetError:
        raise
    except (*_DAMAGED, images.DecompressionBombError) as error:
        raise TargetError(f"{os.fspath(path)} cannot be read as an image: {error}") from None
