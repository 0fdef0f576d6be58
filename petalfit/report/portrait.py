"""Pictures of organs and flowers: coloured surfaces, lit from the upper left of the viewer."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from petalfit.colours import Colour, to_srgb
from petalfit.compilation import Program
from petalfit.flowers import Flower, grow
from petalfit.observations.atomic import atomic_path
from petalfit.report.raster import Canvas, png

_LIGHT = np.array([-0.5, 0.75, 0.6]) / np.linalg.norm([-0.5, 0.75, 0.6])
_MARGIN = 0.04
_REACHES = (5, 12, 26)  # distances in pixels at which depths are compared
_AROUND = 8  # number of directions in which depths are compared
_FINE = 2  # pixels drawn per pixel shown, in each direction


class Sheet(NamedTuple):
    """A coloured surface on a grid.

    Attributes:
        vertices: The vertices, shape (n_u, n_v, 3); y points up.
        normals: The unit normals, shape (n_u, n_v, 3).
        linear: The colours in linear light, in [0, 1], shape (n_u, n_v, 3).
    """

    vertices: Float[np.ndarray, "n_u n_v 3"]
    normals: Float[np.ndarray, "n_u n_v 3"]
    linear: Float[np.ndarray, "n_u n_v 3"]


def flower_sheets(flower: Flower) -> list[Sheet]:
    """All surfaces of a flower, in the flower's frame, with their colours."""
    found = []
    for grown in grow(flower):
        linear = colours_on(flower.colour(grown.part), grown.vertices.shape[1:3])
        placed = grown.in_flower()
        found += [Sheet(*one, linear) for one in zip(placed.vertices, placed.normals, strict=True)]
    return found


def colours_on(colour: Colour, shape: tuple[int, int]) -> Float[np.ndarray, "n_u n_v 3"]:
    """The colours in linear light at the vertices of a grid of the whole domain."""
    u, v = np.linspace(-0.5, 0.5, shape[0]), np.linspace(0, 1, shape[1])
    with jax.enable_x64(True):
        return np.asarray(_colours(colour, u[:, None], v[None, :]))


def _evaluate(colour: Colour, u: Array, v: Array) -> Array:
    return colour(u, v)


_colours = Program(_evaluate)


def portrait(
    sheets: Sequence[Sheet],
    shape: tuple[int, int] = (900, 900),
    azimuth: float = 0.4,
    elevation: float = 0.5,
) -> UInt8[np.ndarray, "h w 4"]:
    """An orthographic picture that shows all given surfaces on a transparent background.

    Args:
        sheets: The surfaces to draw.
        shape: The height and the width in pixels.
        azimuth: The direction of the viewer, in rad from +z towards +x.
        elevation: The angle of the viewer above the horizon, in rad.

    Returns:
        The picture in sRGB with opacity.
    """
    to_viewer = np.array(
        [
            [math.cos(azimuth), 0.0, -math.sin(azimuth)],
            [-math.sin(elevation) * math.sin(azimuth), math.cos(elevation),
             -math.sin(elevation) * math.cos(azimuth)],
            [math.cos(elevation) * math.sin(azimuth), math.sin(elevation),
             math.cos(elevation) * math.cos(azimuth)],
        ]
    )  # fmt: skip
    height, width = (_FINE * side for side in shape)
    seen = [sheet.vertices @ to_viewer.T for sheet in sheets]
    corners = np.concatenate([points.reshape(-1, 3) for points in seen])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    scale = float((1 - 2 * _MARGIN) * min(width / size[0], height / size[1]))
    middle = 0.5 * (low + high)
    canvas = Canvas((height, width))
    for points, sheet in zip(seen, sheets, strict=True):
        x = 0.5 * width + scale * (points[..., 0] - middle[0])
        y = 0.5 * height - scale * (points[..., 1] - middle[1])
        canvas.sheet(np.stack([x, y], axis=-1), points[..., 2], _lit(sheet, to_viewer))
    return _reduced(_shaded(canvas, scale))


def _lit(sheet: Sheet, to_viewer: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "n_u n_v 3"]:
    """The sRGB colours of a lit surface that is matt, slightly translucent, and alike on both sides."""
    normals = sheet.normals @ to_viewer.T
    normals = np.where(normals[..., 2:] < 0, -normals, normals)
    cosine = normals @ _LIGHT
    front, through = np.clip(cosine, 0, 1), np.clip(-cosine, 0, 1)
    sky = 0.5 + 0.5 * normals[..., 1]
    strength = 0.46 + 0.25 * sky + 0.62 * front + 0.30 * through
    with jax.enable_x64(True):
        return np.asarray(_srgb(np.clip(sheet.linear * strength[..., None], 0, 1)))


_srgb = Program(to_srgb)


def _shaded(canvas: Canvas, scale: float) -> UInt8[np.ndarray, "h w 4"]:
    """The picture, darkened where the surroundings are slightly nearer to the viewer (between petals)."""
    rgba = canvas.rgba
    depth = np.where(rgba[..., 3] > 0, scale * canvas.depth, -1e6).astype(np.float32)
    dark = np.zeros(depth.shape, np.float32)
    for ring, reach in enumerate(_REACHES):
        for angle in 2 * np.pi * (np.arange(_AROUND) + ring / len(_REACHES)) / _AROUND:
            shift = np.rint(reach * np.array([np.sin(angle), np.cos(angle)])).astype(int)
            rise = (np.roll(depth, shift, axis=(0, 1)) - depth) / reach
            # Surfaces far in front do not darken what is behind them.
            dark += np.clip(rise - 0.1, 0, 1) * np.exp(-np.square(np.clip(rise, 0, 10) / 3))
    shaded = rgba.copy()
    kept = 1 - dark / (_AROUND * len(_REACHES))
    shaded[..., :3] = np.rint(rgba[..., :3] * np.clip(kept, 0, 1)[..., None])
    return shaded


def _reduced(rgba: UInt8[np.ndarray, "fine_h fine_w 4"]) -> UInt8[np.ndarray, "h w 4"]:
    """The picture in which every pixel is the mean of the finer pixels in it."""
    height, width, _ = rgba.shape
    blocks = rgba.reshape(height // _FINE, _FINE, width // _FINE, _FINE, 4).astype(np.float64)
    opacity = blocks[..., 3:]
    total = np.maximum(opacity.sum(axis=(1, 3)), 1e-9)
    colour = (blocks[..., :3] * opacity).sum(axis=(1, 3)) / total
    return np.rint(np.concatenate([colour, opacity.mean(axis=(1, 3))], axis=-1)).astype(np.uint8)


def write_portrait(flower: Flower, path: str | os.PathLike[str]) -> None:
    """Write a picture of a flower as PNG, completely or not at all.

    Args:
        flower: The flower.
        path: The path of the `.png` file; an existing file is replaced.

    Raises:
        FlowerError: The flower would not fit into memory.
        OSError: The file cannot be written.
    """
    content = png(portrait(flower_sheets(flower)))
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
