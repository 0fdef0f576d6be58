"""Conversion between sRGB, which pictures store, and linear light, in which colours mix.

The formulas are those of IEC 61966-2-1. Its limits below which the curve is a line are rounded:
0.0031308 of light is 0.04044998 in sRGB, not 0.04045. The limit of light here lies in the gap that
the curve of 0.04045 leaves, so that both conversions are inverse to each other everywhere.
"""

from __future__ import annotations

import re

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_SLOPE = 12.92
_LINE_END = 0.04045  # in sRGB
_LINE_END_OF_LIGHT = 0.003130806

_HEX = re.compile(r"#[0-9a-fA-F]{6}")


def to_linear(srgb: Float[Array | np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
    """Converts sRGB values to linear light, both in [0, 1]."""
    srgb = jnp.asarray(srgb)
    curved = ((jnp.maximum(srgb, _LINE_END) + 0.055) / 1.055) ** 2.4
    return jnp.where(srgb <= _LINE_END, srgb / _SLOPE, curved)


def to_srgb(linear: Float[Array | np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
    """Converts linear light to sRGB values, both in [0, 1]."""
    linear = jnp.asarray(linear)
    curved = 1.055 * jnp.maximum(linear, _LINE_END_OF_LIGHT) ** (1 / 2.4) - 0.055
    return jnp.where(linear <= _LINE_END_OF_LIGHT, _SLOPE * linear, curved)


def from_hex(text: str) -> Float[np.ndarray, "3"]:
    """The sRGB values in [0, 1] of a colour in CSS notation, such as "#c2185b".

    Raises:
        ValueError: The text is not a colour in this notation.
    """
    if not _HEX.fullmatch(text):
        raise ValueError(f"a colour is written like '#c2185b'; received {text!r}")
    return np.array([int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)])


def to_hex(srgb: Float[Array | np.ndarray, "3"]) -> str:
    """An sRGB colour in CSS notation, rounded to 256 levels."""
    levels = np.rint(255 * np.clip(np.asarray(srgb, float), 0, 1)).astype(int)
    return "#" + "".join(f"{level:02x}" for level in levels)
