"""Colours that differ for every kind of colour vision, on white paper and on a dark screen."""

from __future__ import annotations

import colorsys

import numpy as np
from jaxtyping import Float

FRONT = np.array([0.945, 0.690, 0.765])  # the side of the petal that its normal points to
REAR = np.array([0.820, 0.560, 0.690])
POINT = np.array([0.110, 0.360, 0.640])
MASK = np.array([0.560, 0.600, 0.620])
IGNORED = np.array([0.550, 0.550, 0.570])  # points without weight

# Blue, grey and vermilion differ in hue for every reader, and the grey in the middle is visible on
# white and on black alike.
NEGATIVE = np.array([0.055, 0.410, 0.790])
ZERO = np.array([0.690, 0.690, 0.700])
POSITIVE = np.array([0.840, 0.310, 0.020])


def diverging(t: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 3"]:
    """The colour of a signed value from −1 to 1; the last colour beyond that, and grey for NaN."""
    t = np.clip(np.nan_to_num(t, posinf=1.0, neginf=-1.0), -1, 1)[..., None]
    return ZERO + np.where(t < 0, -t * (NEGATIVE - ZERO), t * (POSITIVE - ZERO))


def shaded(
    rgb: Float[np.ndarray, "*shape 3"], lit: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape 3"]:
    """A matt colour under a light: `lit` is the cosine between normal and light, in [0, 1]."""
    return rgb * (0.46 + 0.54 * lit[..., None]) + 0.10 * lit[..., None] ** 12


def of_petal(number: int) -> Float[np.ndarray, "3"]:
    """The colour of a petal of a flower; those of neighbours are a golden angle of hue apart."""
    hue, lightness = (137.5 * number) % 360 / 360, 0.45 + 0.1 * (number % 2)
    return np.array(colorsys.hls_to_rgb(hue, lightness, 0.65))


def css(rgb: Float[np.ndarray, "3"]) -> str:
    """The colour in CSS notation."""
    red, green, blue = (round(255 * float(part)) for part in rgb)
    return f"#{red:02x}{green:02x}{blue:02x}"
