"""Sizes to which arrays are padded, so that programs are compiled for few shapes."""

from __future__ import annotations

import numpy as np

BLOCK = 512  # rows that a program for blocks takes at once
_FEWEST = 4  # blocks, for which it is worth to split rows


def bucket(n: int) -> int:
    """The size to which n rows are padded: 64, 96, 128, 192, 256 and so on."""
    power = max(64, 1 << (n - 1).bit_length())
    return power * 3 // 4 if n <= power * 3 // 4 and power > 64 else power


def split_into(n: int) -> int:
    """The number of blocks that n rows are computed in; 1 if they are few, or not a number of blocks."""
    number, rest = divmod(n, BLOCK)
    return 1 if rest or number < _FEWEST else number


def pad_to(rows: np.ndarray, size: int) -> np.ndarray:
    """The rows, padded to `size` with copies of the first row."""
    return np.concatenate([rows, np.repeat(rows[:1], size - len(rows), axis=0)])


def blocks(rows: np.ndarray, padding: float | None = None) -> list[np.ndarray]:
    """The rows in blocks of `BLOCK`; the last one is filled up with `padding`, or the first row."""
    number = -(-len(rows) // BLOCK)
    fill = rows[:1] if padding is None else np.full_like(rows[:1], padding)
    filled = [rows, np.repeat(fill, number * BLOCK - len(rows), axis=0)]
    return np.split(np.concatenate(filled), number)
