"""Segmentation of a photo: a mask of the pixels that belong to one petal or one flower."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from petalfit.observations.errors import TargetError
from petalfit.observations.images import opened_image

_WORKING_SIDE = 400  # pixels; shapes are found in a smaller image, edges in the photo itself
_CLUSTERS = 6
_STIFFNESS = 300.0  # the random walker's beta: how strongly a change of colour impedes it
_SMALLEST = 1e-3  # the smallest area of an object, as a fraction of the image
_PASSES = 2
_NECK = 0.25  # half width of a neck between two objects, relative to the thickest part's, at most


def read_photo(path: str | os.PathLike[str]) -> Float[np.ndarray, "h w c"]:
    """Reads the colours of an image from 0 to 1, and its alpha channel unless that is constant.

    Raises:
        TargetError: The file cannot be read as an image.
    """
    from PIL import ImageOps

    with opened_image(path) as opened:
        image = ImageOps.exif_transpose(opened)  # upright, whichever way the camera was held
        array = np.asarray(image.convert("RGBA"), np.float64) / 255
    return array if np.ptp(array[..., 3]) > 0 else array[..., :3]


def segment(
    photo: Float[np.ndarray, "h w c"], points: Sequence[tuple[float, float]] = ()
) -> Bool[np.ndarray, "h w"]:
    """Finds the mask of one object in a photo.

    An alpha channel is used as the mask. Otherwise the colours along the border are taken for those of
    the background and, if points are given, the colours around them for those of the object; a random
    walker on the colours then finds the boundary between the two.

    Args:
        photo: Colours from 0 to 1, (H, W, 3), or (H, W, 4) with an alpha channel.
        points: Places (x, y) in pixels that lie on the object. Without points, the object is the largest
            region whose colours differ most from the border of the photo.

    Returns:
        A mask that is true on the object, which is one piece without holes.

    Raises:
        TargetError: A point lies outside the photo, or no object stands out.
    """
    from skimage.color import rgb2lab
    from skimage.transform import resize

    rows, columns = photo.shape[:2]
    for x, y in points:
        if not (0 <= x < columns and 0 <= y < rows):
            raise TargetError(
                f"the point {x:g},{y:g} lies outside the photo of {columns} × {rows} pixels (x, y)."
            )
    if photo.shape[2] == 4:
        return _one_piece(np.asarray(photo[..., 3] >= 0.5), [(x, y) for x, y in points])
    scale = min(1.0, _WORKING_SIDE / max(rows, columns))
    shape = max(8, round(rows * scale)), max(8, round(columns * scale))
    factors = np.array([shape[1] / columns, shape[0] / rows])
    seeds = [(float(x), float(y)) for x, y in (np.asarray(points).reshape(-1, 2) + 0.5) * factors]
    lab = rgb2lab(resize(photo, (*shape, 3), anti_aliasing=scale < 1))
    border = np.zeros(shape, bool)
    rim = max(2, round(0.03 * min(shape)))
    border[:rim], border[-rim:], border[:, :rim], border[:, -rim:] = True, True, True, True
    inside = _near(seeds, shape, 0.03)
    evidence = _evidence(lab, inside, border & ~inside) if seeds else _standing_out(lab, border)
    # The colours of the region found so far help to find the rest of the object.
    for _ in range(_PASSES):
        found = _one_piece(_walk(lab, evidence, seeds) >= 0.5, seeds)
        evidence = _evidence(lab, found, ~found)
    full = resize(_walk(lab, evidence, seeds), (rows, columns), order=1)
    return _one_piece(np.asarray(full >= 0.5), [(x, y) for x, y in points])


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
