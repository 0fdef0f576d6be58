"""Sizes that arrays are padded to, so that few shapes compile."""

from __future__ import annotations

import numpy as np


def bucket(n: int) -> int:
    """The size that n rows are padded to, one of 64, 96, 128, 192, 256 and so on."""
    power = max(64, 1 << (n - 1).bit_length())
    return power * 3 // 4 if n <= power * 3 // 4 and power > 64 else power


def pad_to(rows: np.ndarray, size: int) -> np.ndarray:
    """The rows, followed by as many copies of the first as are missing."""
    return np.concatenate([rows, np.repeat(rows[:1], size - len(rows), axis=0)])
