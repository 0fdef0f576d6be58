"""Sizes to which arrays are padded, so that programs are compiled for few shapes."""

from __future__ import annotations

import numpy as np

BLOCK = 512  # points that the likelihood of a sheet takes at once
ROWS = 2048  # that a `RowProgram` takes at once, at most


def bucket(n: int) -> int:
    """The size to which n rows are padded: 64, 96, 128, 192, 256 and so on."""
    power = max(64, 1 << (n - 1).bit_length())
    return power * 3 // 4 if n <= power * 3 // 4 and power > 64 else power


def pad_to(rows: np.ndarray, size: int, padding: float | None = None) -> np.ndarray:
    """The rows, filled up to `size` with `padding`, or the first row, or zeros if there is none."""
    empty = np.zeros((1, *rows.shape[1:]), rows.dtype)
    fill = (rows[:1] if len(rows) else empty) if padding is None else empty + padding
    return np.concatenate([rows, np.repeat(fill, size - len(rows), axis=0)])


def blocks(rows: np.ndarray, padding: float | None = None) -> list[np.ndarray]:
    """The rows in blocks of one size, at least one; the last one is filled up as by `pad_to`."""
    number = max(-(-len(rows) // BLOCK), 1)
    return np.split(pad_to(rows, number * BLOCK, padding), number)
