"""The coverage of pixels that an image or an array stands for, however its tool writes masks.

Tools write the petal as 255, 1, a class number, a colour, an alpha value or any other value. What counts
is that there are two values, and between them no more than a thin edge.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, Shaped

from petalfit.observations.errors import TargetError
from petalfit.observations.images import opened_image, upright

if TYPE_CHECKING:
    from PIL.Image import Image

# A mask has at most this fraction of pixels that are neither covered nor uncovered.
_MOST_GREY = 0.25
# Colours that a pixel may have besides those between two colours: in levels of 255, and what share.
_OFF_LINE, _FEW = 8.0, 1e-3
_SAMPLE = 1 << 20
_BLACK = 30  # the sum of the channels of a colour that is black, or nearly
# The largest class number of an image with several labels.
_LABELS = 64
# An alpha channel that leaves more of the border covered has corners cut off, or a caption.
_MOST_OF_BORDER = 2 / 3


def read_coverage(path: str | os.PathLike[str]) -> Float64[np.ndarray, "h w"]:
    """Reads a mask from an image or a `.npy` file.

    Raises:
        TargetError: The file cannot be read, or is a photo instead of a mask.
    """
    try:
        if Path(path).suffix.lower() == ".npy":
            return coverage(_read_npy(path))
        with opened_image(path) as opened:
            channels = _channels(upright(opened))
        return _of_channels(*channels)
    except _IsPhotoError:
        raise TargetError(
            f"{os.fspath(path)} looks like a photo and no mask; `petalfit mask {os.fspath(path)} -o "
            "MASK.png` makes a mask of it."
        ) from None


def coverage(array: Shaped[np.ndarray, "h w"]) -> Float64[np.ndarray, "h w"]:
    """The coverage from 0 to 1 that the grey values of a mask stand for.

    Of two values the higher one is the petal's. Of more, the highest that is frequent.

    Raises:
        TargetError: The array has several labels, or as many greys as a photo.
    """
    if array.ndim != 2 or array.dtype.kind not in "biuf":
        raise TargetError(
            f"the mask has shape {array.shape} and type {array.dtype}, expected (H, W), bool or "
            "numbers."
        )
    if array.dtype == bool or not array.size:
        return array.astype(np.float64)
    low, high = array.min(), array.max()
    if not (np.isfinite(low) and np.isfinite(high)):
        raise TargetError("the mask has a NaN or an infinite value.")
    if low == high:
        return np.full(array.shape, float(low > 0))
    covered = array == high
    if (covered | (array == low)).all():
        return covered.astype(np.float64)
    if low < 0:
        raise TargetError(
            f"the mask has values from {low:g} to {high:g}; expected 0 for the background."
        )
    if array.dtype.kind in "iu" and high < _LABELS:
        labels = [int(x) for x in np.unique(array) if x]
        raise TargetError(
            f"the mask has {len(labels)} labels ({', '.join(map(str, labels[:8]))}); save a mask of "
            "one petal, with 0 elsewhere."
        )
    found = np.minimum(array / _top(array, float(high)), 1.0)
    if np.mean((found > 0.1) & (found < 0.9)) > _MOST_GREY:
        raise _IsPhotoError("the mask has many values between 0 and its highest, as a photo does.")
    return found


class _IsPhotoError(TargetError):
    """An image that is a photo and no mask."""


def _top(array: np.ndarray, high: float) -> float:
    """The value of full coverage: that of the type if it is reached, else the one most pixels have."""
    if array.dtype == np.uint8:
        full = 255.0
    elif array.dtype.kind == "f":
        full = next((x for x in (1.0, 255.0) if high <= x), 65535.0)
    else:
        full = 255.0 if high <= 255 else 65535.0
    if high >= 0.98 * full:
        return max(full, high)
    return float(np.quantile(array[array > 0.5 * high], 0.9))


def _read_npy(path: str | os.PathLike[str]) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise TargetError(f"{os.fspath(path)} does not exist; check the path.") from None
    except Exception as error:  # NumPy raises errors of any kind for damaged headers
        raise TargetError(f"{os.fspath(path)} cannot be read as an array: {error}") from None
    return array if isinstance(array, np.ndarray) else np.empty(0)


Channels = tuple[np.ndarray, np.ndarray | None, np.ndarray | None]


def _channels(image: Image) -> Channels:
    """The grey or colour values of an image, its alpha channel and its palette's indices, if any."""
    alpha = None
    if image.has_transparency_data:
        alpha = np.asarray(image.convert("RGBA").getchannel("A"))
    indices = np.asarray(image) if image.mode == "P" else None
    if image.mode == "LA":
        image = image.convert("L")
    grey = image.mode[0] in "1LIF" and image.mode != "LAB"
    return np.asarray(image if grey else image.convert("RGB")), alpha, indices


def _of_channels(
    values: np.ndarray, alpha: np.ndarray | None, indices: np.ndarray | None
) -> np.ndarray:
    if alpha is not None and is_mask(alpha):
        return coverage(alpha)
    if values.ndim == 2:
        return coverage(values)
    if indices is not None and np.ptp(indices) > 0 and not np.ptp(values, axis=(0, 1)).any():
        return coverage(indices)  # labels whose palette shows them alike
    if not values.size or np.ptp(values, axis=2).max() <= 2:
        return coverage(values[..., 0])
    return _between_two_colours(values)


def is_mask(alpha: Shaped[np.ndarray, "h w"]) -> bool:
    """Whether an alpha channel cuts an object out, and not just corners off a photo."""
    opaque = alpha >= 0.5 * max(float(alpha.max(initial=0)), 1e-9)
    return bool(np.ptp(alpha) > 0 and _along_border(opaque).mean() <= _MOST_OF_BORDER)


def _along_border(array: np.ndarray) -> np.ndarray:
    """The pixels at the border of an image, in any order."""
    return np.concatenate([array[0], array[-1], array[1:-1, 0], array[1:-1, -1]])


def _between_two_colours(colours: np.ndarray) -> np.ndarray:
    """The coverage by the second of two colours, if there are but these and mixtures at edges.

    The background is black, or else the colour of most of the border.
    """
    sample = colours.reshape(-1, 3)[:: 1 + colours.shape[0] * colours.shape[1] // _SAMPLE]
    found, counts = np.unique(sample, axis=0, return_counts=True)
    if len(found) < 2:
        raise _IsPhotoError
    ground, object_ = found[np.argsort(counts)[-2:]].astype(float)
    border = _along_border(colours).astype(float)

    def at_border(colour: np.ndarray) -> int:
        return int(np.count_nonzero(np.abs(border - colour).max(axis=1) <= _OFF_LINE))

    is_black = object_.sum() <= _BLACK
    if is_black or (ground.sum() > _BLACK and at_border(object_) > at_border(ground)):
        ground, object_ = object_, ground
    along = (object_ - ground) / np.sum((object_ - ground) ** 2)
    share = (colours - ground) @ along
    off = np.zeros(share.shape)
    for channel in range(3):
        expected = ground[channel] + np.clip(share, 0, 1) * (object_ - ground)[channel]
        np.maximum(off, np.abs(colours[..., channel] - expected), out=off)
    if np.mean(off > _OFF_LINE) > _FEW:
        raise _IsPhotoError
    return coverage(np.clip(share, 0, 1))
