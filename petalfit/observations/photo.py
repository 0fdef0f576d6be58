"""Segmentation of a photo: a mask of the pixels that belong to one petal or one flower."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from petalfit.observations.coverage import is_mask
from petalfit.observations.errors import TargetError
from petalfit.observations.images import opened_image, upright

_WORKING_SIDE = 400  # pixels; what belongs to the object is found in a small picture,
_EDGE_SIDE = 1600  # and its piece is cut out in a larger one, between whose pixels the edge runs
# The shares of the border and of the picture that no object fills.
_MOST_OF_BORDER, _SOME_OF_BORDER, _MOST_OF_PICTURE = 0.5, 0.2, 2 / 3
_CLUSTERS = 6
_STIFFNESS = 300.0  # the random walker's beta: how strongly a change of colour impedes it
_SMALLEST = 1e-3  # the smallest area of an object, as a fraction of the image
_PASSES = 2
_NECK = 0.25  # half width of a neck between two objects, relative to the thickest part's, at most


def read_photo(path: str | os.PathLike[str]) -> UInt8[np.ndarray, "h w c"]:
    """Reads the colours of an image as bytes, and its alpha channel if that cuts an object out.

    Raises:
        TargetError: The file cannot be read as an image.
    """
    with opened_image(path) as opened:
        image = upright(opened)
        if image.has_transparency_data:
            array = np.asarray(image.convert("RGBA"))
            return array if is_mask(array[..., 3]) else array[..., :3]
        if image.mode[0] in "IF":  # Pillow would cut 16 bits off at 255
            grey = np.asarray(image, np.float64)
            grey = grey * (255 / max(float(grey.max(initial=0)), 1e-9))
            return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        return np.asarray(image.convert("RGB"))


def segment(
    photo: UInt8[np.ndarray, "h w c"] | Float[np.ndarray, "h w c"],
    points: Sequence[tuple[float, float]] = (),
) -> Bool[np.ndarray, "h w"]:
    """Finds the mask of one object in a photo.

    An alpha channel is used as the mask. Otherwise the colours along the border are taken for those of
    the background and, if points are given, the colours around them for those of the object; a random
    walker on the colours then finds the boundary between the two. If that object fills the border, as
    the paper of a scan does, it is the background, and the object is the largest that lies on it.

    Args:
        photo: Colours as bytes or from 0 to 1, (H, W, 3), or (H, W, 4) with an alpha channel.
        points: Places (x, y) in pixels that lie on the object. Without points, the object is the largest
            region whose colours differ most from the border of the photo.

    Returns:
        A mask that is true on the object, which is one piece without holes.

    Raises:
        TargetError: A point lies outside the photo, no object stands out, or it fills the border.
    """
    rows, columns = photo.shape[:2]
    for x, y in points:
        if not (0 <= x < columns and 0 <= y < rows):
            raise TargetError(
                f"the point {x:g},{y:g} lies outside the photo of {columns} × {rows} pixels (x, y)."
            )
    if photo.dtype != np.uint8:
        photo = np.rint(255 * np.clip(photo, 0, 1)).astype(np.uint8)
    if photo.shape[2] == 4:
        likely = resized(photo[..., 3] / np.float32(255), _within(photo.shape, _EDGE_SIDE))
        seeds = _scaled(points, photo.shape, likely.shape)
    else:
        likely, seeds = _likely(photo, points)
    piece = _one_piece(likely >= 0.5, seeds)
    _check_no_ground(piece, bool(points))
    # Only the object stays, without holes, with its edge between the pixels of the smaller picture.
    alone = np.where(piece, np.maximum(likely, 0.51), np.minimum(likely, 0.49))
    found = resized(alone.astype(np.float32), (rows, columns)) >= 0.5
    if photo.shape[2] == 4 and likely.shape != found.shape:
        found = np.where(_near_edge(alone, found.shape), photo[..., 3] >= 128, found)
    return found


def resized(
    picture: Float32[np.ndarray, "h w"] | UInt8[np.ndarray, "h w 3"], shape: tuple[int, int]
) -> Any:
    """A picture of another shape: averages of its pixels, or values between them."""
    from PIL import Image

    if picture.shape[:2] == shape:
        return picture
    image = Image.fromarray(picture)
    return np.asarray(image.resize((shape[1], shape[0]), Image.Resampling.BILINEAR))


def _within(shape: Sequence[int], side: int) -> tuple[int, int]:
    """The shape of the same picture with at most `side` pixels a side."""
    scale = min(1.0, side / max(shape[:2]))
    return max(8, round(shape[0] * scale)), max(8, round(shape[1] * scale))


def _scaled(
    points: Sequence[tuple[float, float]], shape: Sequence[int], other: Sequence[int]
) -> list[tuple[float, float]]:
    """The places of points in a picture of another shape."""
    across, down = other[1] / shape[1], other[0] / shape[0]
    if across == down == 1:
        return [(float(x), float(y)) for x, y in points]
    return [((x + 0.5) * across, (y + 0.5) * down) for x, y in points]


def _near_edge(alone: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The pixels of a larger picture at which the edge in the smaller one may run."""
    from scipy import ndimage

    inside = alone >= 0.5
    outer = np.asarray(ndimage.binary_dilation(inside, iterations=2))
    inner = np.asarray(ndimage.binary_erosion(inside, iterations=2))
    return resized((outer > inner).astype(np.float32), shape) >= 0.5


def _likely(
    photo: np.ndarray, points: Sequence[tuple[float, float]]
) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """How likely the pixels of a smaller picture are the object's, from 0 to 1, and places on it."""
    from skimage.color import rgb2lab

    shape = _within(photo.shape, _WORKING_SIDE)
    seeds = _scaled(points, photo.shape, shape)
    lab = rgb2lab(resized(photo, shape))
    border = np.zeros(shape, bool)
    rim = max(2, round(0.03 * min(shape)))
    border[:rim], border[-rim:], border[:, :rim], border[:, -rim:] = True, True, True, True
    inside = _near(seeds, shape, 0.03)
    evidence = _evidence(lab, inside, border & ~inside) if seeds else _standing_out(lab, border)
    # The colours of the region found so far help to find the rest of the object.
    for _ in range(_PASSES):
        found = _one_piece(_walk(lab, evidence, seeds) >= 0.5, seeds)
        if not seeds and _is_ground(found):
            found = _lying_on(lab, found)
            seeds = [_inside(found)]
        evidence = _evidence(lab, found, ~found)
    likely = _walk(lab, evidence, seeds).astype(np.float32)
    shape = _within(photo.shape, _EDGE_SIDE)
    return resized(likely, shape), _scaled(seeds, likely.shape, shape)


def _share_of_border(found: np.ndarray) -> float:
    return float(np.concatenate([found[0], found[-1], found[:, 0], found[:, -1]]).mean())


def _is_ground(found: np.ndarray) -> bool:
    """Whether a region is what objects lie on: it fills the border, or nearly all of the picture."""
    share = _share_of_border(found)
    fills = bool(found.mean() > _MOST_OF_PICTURE)
    return share > _MOST_OF_BORDER or (share > _SOME_OF_BORDER and fills)


def _check_no_ground(found: np.ndarray, pointed: bool) -> None:
    """Raises an error if what was found is the background."""
    if not _is_ground(found):
        return
    remedy = "name more points on the petal" if pointed else "say where it is with --point x,y"
    raise TargetError(
        f"what was found fills {100 * found.mean():.0f} % of the photo and "
        f"{100 * _share_of_border(found):.0f} % of its border, as a background does and no petal; "
        f"{remedy}, or cut the photo so that the background is on all sides."
    )


def _inside(found: np.ndarray) -> tuple[float, float]:
    """The place (x, y) farthest from the edge of a region."""
    from scipy import ndimage

    depth = np.asarray(ndimage.distance_transform_edt(found))
    row, column = np.unravel_index(np.argmax(depth), depth.shape)
    return float(column), float(row)


def _lying_on(lab: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """The largest object that differs from the commonest colour of a ground and lies on it."""
    from skimage.filters import gaussian, threshold_otsu
    from skimage.segmentation import clear_border

    away = gaussian(np.linalg.norm(lab - np.median(lab[ground], axis=0), axis=-1), 1.0)
    return _one_piece(np.asarray(clear_border(away > threshold_otsu(away))), [])


def _standing_out(lab: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Evidence from −1 to 1 that a pixel's colour differs from those of the border."""
    from skimage.filters import gaussian, threshold_otsu

    away = gaussian(_distance_to_colours(lab, border, ~border), 1.5)
    threshold = threshold_otsu(away)
    if not 0 < 1.5 * threshold < away.max():
        raise TargetError(
            "nothing stands out from the border of the photo; say where the petal is with --point x,y."
        )
    return np.clip((away - threshold) / threshold, -1, 1)


def _evidence(lab: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Evidence from −1 to 1 that a pixel has one of the colours inside rather than outside."""
    from skimage.filters import gaussian

    own, other = _distance_to_colours(lab, inside), _distance_to_colours(lab, outside, inside)
    return gaussian((other - own) / (other + own + 1e-9), 1.0)


def _near(seeds: list[tuple[float, float]], shape: tuple[int, int], reach: float) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    near = np.zeros(shape, bool)
    for seed_x, seed_y in seeds:
        near |= np.hypot(x - seed_x, y - seed_y) <= max(1.0, reach * min(shape))
    return near


def _distance_to_colours(
    lab: np.ndarray, where: np.ndarray, elsewhere: np.ndarray | None = None
) -> np.ndarray:
    """The distance to the nearest typical colour of a region, in units of that colour's spread.

    Colours that are more frequent in `elsewhere` are not counted for the region: another orange flower
    in the background does not make orange a background colour.
    """
    from scipy.cluster.vq import kmeans2, vq

    sample = lab[where]
    k = min(_CLUSTERS, max(1, len(sample) // 20), len(np.unique(np.round(sample), axis=0)))
    centres, label = kmeans2(sample, k, minit="++", rng=0)
    share = np.bincount(label, minlength=k) / len(sample)
    own = share > 0
    if elsewhere is not None:
        there = np.bincount(vq(lab[elsewhere], centres)[0], minlength=k) / np.sum(elsewhere)
        foreign = there > 1.5 * share
        own &= ~foreign | (share == share.max())
    distances = []
    for j in np.flatnonzero(own):
        spread = 4.0 + np.sqrt(np.mean(np.sum((sample[label == j] - centres[j]) ** 2, axis=-1)))
        distances.append(np.linalg.norm(lab - centres[j], axis=-1) / spread)
    return np.min(distances, axis=0)


def _walk(lab: np.ndarray, evidence: np.ndarray, seeds: list[tuple[float, float]]) -> np.ndarray:
    """The probability of the object, by a random walk from the most certain pixels of either kind."""
    from skimage.segmentation import random_walker

    markers = np.zeros(evidence.shape, int)
    markers[evidence > 0.35] = 1
    markers[evidence < -0.35] = 2
    markers[_near(seeds, evidence.shape, 0.01)] = 1
    if not (markers == 2).any():
        raise TargetError("the photo shows no background; leave some around the petal.")
    colours = lab / np.array([100.0, 128.0, 128.0])
    walked = random_walker(
        colours,
        markers,
        beta=_STIFFNESS,
        mode="cg_j",
        tol=1e-4,
        prob_tol=1.0,
        channel_axis=-1,
        return_full_prob=True,
    )
    return walked[0]


def _one_piece(mask: np.ndarray, points: list[tuple[float, float]]) -> np.ndarray:
    """The piece with the first point, or else the largest piece, smoothed and with its holes filled.

    Pieces that are joined by a narrow neck are cut apart there.
    """
    from scipy import ndimage
    from skimage.measure import label
    from skimage.morphology import disk, opening
    from skimage.segmentation import watershed

    radius = max(1, round(0.003 * min(mask.shape)))
    pieces: Any = label(opening(mask, disk(radius)))
    piece: np.ndarray = pieces == _chosen(pieces, points)
    depth = np.asarray(ndimage.distance_transform_edt(piece))
    cores: Any = label(depth > _NECK * depth.max(), connectivity=2)
    sizes = np.bincount(cores.ravel())[1:]
    large = 1 + np.flatnonzero(sizes > 0.02 * sizes.max(initial=0))
    if len(large) > 1:
        parts: Any = watershed(-depth, np.where(np.isin(cores, large), cores, 0), mask=piece)
        piece = parts == _chosen(parts, points)
    if piece.sum() < _SMALLEST * mask.size:
        raise TargetError(
            "no object stands out from the background; say where the petal is with --point x,y, or "
            "cut the photo closer around it."
        )
    return np.asarray(ndimage.binary_fill_holes(piece))


def _chosen(labels: np.ndarray, points: list[tuple[float, float]]) -> int:
    """The label under the first point that has one, or else the most frequent label."""
    for x, y in points:
        if labels[int(y), int(x)]:
            return int(labels[int(y), int(x)])
    sizes = np.bincount(labels.ravel(), minlength=2)
    return 1 + int(np.argmax(sizes[1:]))
