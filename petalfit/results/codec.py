"""Lossless encoding of values in JSON: arrays become lists, and infinities become strings."""

from __future__ import annotations

from typing import Any

import numpy as np

_NOT_FINITE = {"inf": np.inf, "-inf": -np.inf, "nan": np.nan}


def encode(value: Any) -> Any:
    """Encodes a value for JSON; infinities and NaN, which JSON does not have, become strings."""
    if isinstance(value, dict):
        return {key: encode(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist() if np.isfinite(value).all() else encode(value.tolist())
    if isinstance(value, list | tuple):
        return [encode(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return str(float(value))
    return value


def decode(value: Any) -> Any:
    """Decodes what `encode` returned; sequences come back as lists."""
    if isinstance(value, dict):
        return {key: decode(item) for key, item in value.items()}
    if isinstance(value, list):
        flat = value and isinstance(value[0], float)
        return value if flat and all(type(x) is float for x in value) else [*map(decode, value)]
    return _NOT_FINITE.get(value, value) if isinstance(value, str) else value
