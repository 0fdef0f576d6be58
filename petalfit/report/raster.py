"""Pictures of surfaces and points by a depth buffer in plain numpy, and PNG files of them.

A page needs a few shaded surfaces and some thousand dots. numpy draws them in a fraction of the
time that importing a plotting library takes, with correct occlusion in every pixel. Pictures have
twice the pixels at which they are shown, so browsers smooth their edges.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from jaxtyping import Float, Int, UInt8

# A lattice of samples covers every pixel if its sides are at most 1/√2 of a pixel.
_SPACING = 0.7
# A surface that crosses the picture many times may need any number of samples; beyond this number
# it is drawn with holes.
_LARGEST = 6_000_000


class Canvas:
    """A picture with a depth buffer: each pixel shows the nearest of all that is drawn there.

    Args:
        shape: The height and the width in pixels.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._nearest = np.full(shape[0] * shape[1], -np.inf, np.float32)
        self._rgba = np.zeros((shape[0] * shape[1], 4), np.uint8)

    @property
    def rgba(self) -> UInt8[np.ndarray, "h w 4"]:
        """The picture, transparent where nothing has been drawn."""
        return self._rgba.reshape(*self.shape, 4)

    @property
    def depth(self) -> Float[np.ndarray, "h w"]:
        """The depth of every pixel; larger is nearer to the viewer, −inf where nothing has been drawn."""
        return self._nearest.reshape(*self.shape)

    def sheet(
        self,
        xy: Float[np.ndarray, "n_u n_v 2"],
        depth: Float[np.ndarray, "n_u n_v"],
        rgb: Float[np.ndarray, "n_u n_v 3"],
    ) -> None:
        """Draw a surface on a grid, bilinear in every cell, without holes.

        Args:
            xy: The places of the grid's vertices in pixels, right and down.
            depth: The depths of the vertices; larger is nearer to the viewer.
            rgb: The colours of the vertices in [0, 1].
        """
        grid = np.concatenate([xy, depth[..., None], rgb], axis=-1)
        cells = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]])
        cells = cells.reshape(4, -1, 6).transpose(0, 2, 1).astype(np.float32)
        counts = _sample_counts(cells[:, :2])
        # Cells are drawn by size, so that their samples stay in the processor's cache.
        for pair in np.unique(counts, axis=0):
            u, v = ((np.arange(count, dtype=np.float32) + 0.5) / count for count in pair)
            u, v = (x.ravel() for x in np.meshgrid(u, v))
            corners = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], axis=-1)
            some = cells[..., (counts == pair).all(axis=-1)]
            x, y, near, *colour = (corners @ some[:, channel] for channel in range(6))
            self._draw(x, y, near, np.stack(colour, axis=-1))

    def discs(
        self,
        xy: Float[np.ndarray, "n 2"],
        depth: Float[np.ndarray, " n"],
        rgb: Float[np.ndarray, "n 3"],
        radius: float,
    ) -> None:
        """Draw flat discs that face the viewer.

        Args:
            xy: The places of the centres in pixels, right and down.
            depth: The depths of the discs; larger is nearer to the viewer.
            rgb: The colours of the discs in [0, 1].
            radius: The radius in pixels.
        """
        reach = np.arange(-int(radius) - 1, int(radius) + 2)
        stamp = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
        pixels = np.floor(xy)[:, None] + stamp + 0.5
        disc, pixel = np.nonzero(np.sum((pixels - xy[:, None]) ** 2, axis=-1) <= radius**2)
        x, y = pixels[disc, pixel].T
        self._draw(x, y, depth[disc], rgb[disc])

    def _draw(self, x: np.ndarray, y: np.ndarray, depth: np.ndarray, rgb: np.ndarray) -> None:
        height, width = self.shape
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        place = y[inside].astype(np.int32) * width + x[inside].astype(np.int32)
        near = depth[inside].astype(np.float32)
        np.maximum.at(self._nearest, place, near)
        wins = near == self._nearest[place]
        place = place[wins]
        self._rgba[place, :3] = 255 * np.clip(rgb[inside][wins], 0, 1) + 0.5
        self._rgba[place, 3] = 255


def _sample_counts(corners: Float[np.ndarray, "4 2 cells"]) -> Int[np.ndarray, "cells 2"]:
    """The numbers of samples along u and v that each cell needs, rounded up to few different ones."""
    c00, c01, c10, c11 = corners
    along_u = np.maximum(*(np.hypot(*side) for side in (c10 - c00, c11 - c01)))
    along_v = np.maximum(*(np.hypot(*side) for side in (c01 - c00, c11 - c10)))
    need = np.maximum(np.stack([along_u, along_v], axis=-1) / _SPACING, 1.0)
    need /= max(1.0, float(need.prod(axis=-1).sum() / _LARGEST)) ** 0.5
    return np.ceil(2 ** (np.ceil(3 * np.log2(np.maximum(need, 1.0))) / 3)).astype(int)


def png(rgba: UInt8[np.ndarray, "h w 4"]) -> bytes:
    """A PNG file of a picture; the same picture gives the same bytes."""
    height, width, _ = rgba.shape
    # Filter 1 (the difference to the pixel on the left) makes shaded surfaces compress well.
    left = np.concatenate([np.zeros_like(rgba[:, :1]), rgba[:, :-1]], axis=1)
    rows = np.concatenate([np.ones((height, 1), np.uint8), (rgba - left).reshape(height, -1)], 1)
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
