"""Sizes to which arrays are padded, so that programs are compiled for few shapes."""

from __future__ import annotations

import numpy as np


def bucket(n: int) -> int:
    """The size to which n rows are padded: 64, 96, 128, 192, 256 and so on."""
    power = max(64, 1 << (n - 1).bit_length())
    return power * 3 // 4 if n <= power * 3 // 4 and power > 64 else power


def pad_to(rows: np.ndarray, size: int) -> np.ndarray:
    """The rows, padded to `size` with copies of the first row."""
    return np.concatenate([rows, np.repeat(rows[:1], size - len(rows), axis=0)])
