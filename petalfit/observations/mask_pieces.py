"""The pieces that a mask shows: the petal, what is ignored beside it, and what is no mask of a petal."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float64

from petalfit.observations.errors import TargetError

# A further piece above this fraction of the largest one is another object, a smaller one is ignored.
_ANOTHER = 0.1
# Pieces and holes below this fraction of the petal, or of fewer pixels, are specks that nobody misses.
_SPECK, _SPECK_PIXELS = 2e-4, 16
# A frame reaches over this fraction of the image both ways, and fills little of what it encloses.
_SPANS, _FILLS = 0.9, 0.35
# The share of the border of the image that no petal covers.
_MOST_OF_BORDER = 2 / 3
_FRINGE = 2  # pixels around a piece that its soft edge may reach
# A stalk is at most this wide, in widths of the blade, and so long, in sizes of the whole; it is sought
# in a picture of this many pixels a side.
_STALK_WIDTH, _STALK_LENGTH, _STALK_SIDE = 0.14, 0.15, 400


def petal_alone(
    mask: Float64[np.ndarray, "h w"], trusted: Bool[np.ndarray, "h w"] | None
) -> tuple[Float64[np.ndarray, "h w"], tuple[str, ...]]:
    """The mask without small other pieces, and notes on them, on holes and on a stalk.

    Args:
        mask: Coverage from 0 to 1.
        trusted: Where the mask counts; None for everywhere.

    Raises:
        TargetError: The mask shows several objects, or covers the border of the image.
    """
    from scipy import ndimage

    covered = mask >= 0.5
    if trusted is not None:
        covered &= trusted
    labels = np.empty(mask.shape, np.int32)
    ndimage.label(covered, np.ones((3, 3)), output=labels)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    if not sizes.any():
        return mask, ()
    frame = _frame(labels, sizes)
    others = sizes.copy()
    if frame is not None:
        others[frame] = 0
    petal = int(np.argmax(others))
    others[petal] = 0
    _check_border(labels == petal)
    several = int(np.count_nonzero(others > _ANOTHER * sizes[petal]))
    if several > 0:
        raise TargetError(
            f"the mask shows several objects: {several} more than a tenth as large as the largest. Keep "
            "one, or give the others weight 0."
        )
    notes = [
        *_on_pieces(labels, others, int(sizes[petal]), frame is not None),
        *_on_holes(labels == petal, int(sizes[petal])),
        *_on_stalk(labels == petal),
    ]
    if np.count_nonzero(sizes) > 1:
        beside = (labels != petal) & (labels != 0)
        beside = ndimage.binary_dilation(beside, np.ones((3, 3)), iterations=_FRINGE)
        mask = np.where(beside & (labels != petal), 0.0, mask)
    return mask, tuple(notes)


def _frame(labels: np.ndarray, sizes: np.ndarray) -> int | None:
    """The label of a frame around the picture, if there is one with something inside."""
    from scipy import ndimage

    for label, box in enumerate(ndimage.find_objects(labels), 1):
        height, width = (part.stop - part.start for part in box)
        spans = height >= _SPANS * labels.shape[0] and width >= _SPANS * labels.shape[1]
        if not spans or sizes[label] > _FILLS * height * width:
            continue
        own = labels == label
        inside = ndimage.binary_fill_holes(own) & ~own
        if np.count_nonzero(inside & (labels > 0)) > _SPECK_PIXELS:
            return label
    return None


def _check_border(petal: np.ndarray) -> None:
    """Raises an error if the covered part is what surrounds a petal."""
    border = np.concatenate([petal[0], petal[-1], petal[1:-1, 0], petal[1:-1, -1]])
    share = border.mean()
    if share <= _MOST_OF_BORDER:
        return
    if np.count_nonzero(_holes(petal)) > 0.5 * np.count_nonzero(~petal):
        raise TargetError(
            "the covered part of the mask surrounds the rest and fills "
            f"{100 * share:.0f} % of the image's border: is the mask inverted? The petal is white (1) "
            "and the background black (0)."
        )
    raise TargetError(
        f"the covered part of the mask fills {100 * share:.0f} % of the image's border, where no outline "
        "is seen: is it the background, or does the petal reach beyond the image? Take a wider one."
    )


def _holes(piece: np.ndarray) -> np.ndarray:
    from scipy import ndimage

    return np.asarray(ndimage.binary_fill_holes(piece)) & ~piece


def _on_pieces(labels: np.ndarray, others: np.ndarray, petal: int, has_frame: bool) -> list[str]:
    """A note on other pieces, if they are more than specks."""
    from scipy import ndimage

    notes = []
    if has_frame:
        notes.append("A frame around the picture was ignored.")
    seen = np.flatnonzero(others >= max(_SPECK_PIXELS, _SPECK * petal))
    if len(seen):
        largest = int(np.argmax(others))
        rows, columns = ndimage.find_objects(labels, max_label=largest)[largest - 1]
        size = f"{columns.stop - columns.start} × {rows.stop - rows.start} pixels at x = "
        size += f"{columns.start}, y = {rows.start}"
        what = "1 small other piece" if len(seen) == 1 else f"{len(seen)} small other pieces"
        was = f"was ignored ({size})" if len(seen) == 1 else f"were ignored (the largest {size})"
        notes.append(f"The mask shows {what} beside the petal, which {was}.")
    return notes


def _on_holes(petal: np.ndarray, size: int) -> list[str]:
    """A note on holes, if they are more than specks."""
    from scipy import ndimage

    labels = np.empty(petal.shape, np.int32)
    ndimage.label(_holes(petal), output=labels)
    areas = np.bincount(labels.ravel())[1:]
    count = int(np.count_nonzero(areas >= max(_SPECK_PIXELS, _SPECK * size)))
    if not count:
        return []
    holes = "1 hole in the mask was" if count == 1 else f"{count} holes in the mask were"
    return [f"{holes} ignored: only its outer outline counts."]


def _on_stalk(petal: np.ndarray) -> list[str]:
    """A note on a thin part that hangs on the blade, if there is one."""
    from scipy import ndimage

    rows, columns = (np.flatnonzero(petal.any(axis=axis)) for axis in (1, 0))
    step = 1 + max(rows[-1] - rows[0], columns[-1] - columns[0]) // _STALK_SIDE
    small = np.pad(petal[rows[0] : rows[-1] + 1 : step, columns[0] : columns[-1] + 1 : step], 1)
    depth = np.asarray(ndimage.distance_transform_edt(small))
    radius = _STALK_WIDTH * depth.max()
    blade = np.asarray(ndimage.distance_transform_edt(depth <= radius)) <= radius + 1
    labels = np.empty(small.shape, np.int32)
    ndimage.label(small & ~blade, np.ones((3, 3)), output=labels)
    longest, found = 0.0, None
    for label in range(1, int(labels.max()) + 1):
        y, x = np.nonzero(labels == label)
        length = math.hypot(np.ptp(y) + 1, np.ptp(x) + 1)
        if length > longest:
            longest, found = length, (x, y, 2 * float(depth[y, x].max()))
    whole = math.hypot(*small.shape)
    if found is None or longest < max(_STALK_LENGTH * whole, 3 * found[2]):
        return []
    x, y, width = found
    place = columns[0] + step * (x.mean() - 1), rows[0] + step * (y.mean() - 1)
    return [
        f"A thin part hangs on the petal at x = {place[0]:.0f}, y = {place[1]:.0f}, about "
        f"{step * width:.0f} pixels wide and {step * longest:.0f} long: if it is a stalk, cut it off, "
        "since no model has one."
    ]
