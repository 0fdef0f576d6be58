"""Textures: the colours or intensities of a petal over its domain (u, v)."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from petalfit.observations.errors import TargetError
from petalfit.observations.images import opened_image
from petalfit.observations.validation import ArrayLike, valid_colours, valid_weights

_FEWEST = 16
_LARGEST = 4096 * 4096


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Texture:
    """Colours or intensities at places of a petal's domain, u ∈ [−½, ½] and v ∈ [0, 1].

    Args:
        image: (H, W) intensities, or (H, W, 3) sRGB from 0 to 1 or as bytes. u points to the right and
            the tip (v = 1) is the first row, as in glTF and in every modeller. A fourth channel is
            opacity: where it is 0 the colour is unknown.

    Attributes:
        uv: The places (u, v), shape (n, 2).
        values: Intensities, shape (n,), or sRGB colours, shape (n, 3).
        weights: The number of observations that each place counts for, shape (n,); 0 ignores a place.

    Raises:
        TargetError: The image cannot be used; the message says why and what to do.
    """

    uv: Float64[np.ndarray, "n 2"]
    values: Float64[np.ndarray, " n"] | Float64[np.ndarray, "n 3"]
    weights: Float64[np.ndarray, " n"]

    def __init__(self, image: ArrayLike) -> None:
        image = np.asarray(image)
        is_colour = image.ndim == 3 and image.shape[2] in (3, 4)
        if not (image.ndim == 2 or is_colour):
            raise TargetError(
                f"the texture has shape {image.shape}, expected (H, W), (H, W, 3) or (H, W, 4)."
            )
        height, width = image.shape[:2]
        if width * height > _LARGEST:
            raise TargetError(f"the texture has {width} × {height} pixels; make it smaller.")
        u, v = np.meshgrid(
            (np.arange(width) + 0.5) / width - 0.5, 1 - (np.arange(height) + 0.5) / height
        )
        weights = np.ones(width * height)
        if image.ndim == 3 and image.shape[2] == 4:
            weights = (image[..., 3] > 0).reshape(-1).astype(float)
            image = image[..., :3]
        rows = image.reshape(-1, 3) if is_colour else image.reshape(-1)
        self._set(np.stack([u.ravel(), v.ravel()], axis=-1), rows, weights)

    @classmethod
    def at(cls, uv: ArrayLike, values: ArrayLike, weights: ArrayLike | None = None) -> Texture:
        """Colours or intensities at scattered places.

        Args:
            uv: The places (u, v), (N, 2), within the domain.
            values: (N,) intensities, or (N, 3) sRGB from 0 to 1 or as bytes.
            weights: (N,), at least 0; all 1 if None.

        Raises:
            TargetError: The arrays cannot be used; the message says why and what to do.
        """
        texture = cls.__new__(cls)
        places = np.array(uv, np.float64)
        if places.ndim != 2 or places.shape[1] != 2:
            raise TargetError(f"uv has shape {places.shape}, expected (N, 2).")
        inside = (np.abs(places[:, 0]) <= 0.5) & (places[:, 1] >= 0) & (places[:, 1] <= 1)
        if not inside.all():
            raise TargetError("uv leaves the domain, u from -1/2 to 1/2 and v from 0 to 1.")
        given = np.ones(len(places)) if weights is None else weights
        texture._set(places, np.asarray(values), given)
        return texture

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Texture:
        """Reads a texture from an image file; an image without colour gives intensities.

        Raises:
            TargetError: The file cannot be read as an image, or the image cannot be used.
        """
        with opened_image(path) as image:
            grey = image.mode in ("1", "L", "I", "F", "I;16")
            pixels = np.asarray(image.convert("L" if grey else "RGBA"))
        try:
            return cls(pixels / 255 if grey else pixels)
        except TargetError as error:
            raise TargetError(f"{os.fspath(path)}: {error}") from None

    def __len__(self) -> int:
        return len(self.uv)

    def __repr__(self) -> str:
        kind = "intensities" if self.values.ndim == 1 else "colours"
        return f"Texture({len(self)} {kind})"

    def _set(self, uv: np.ndarray, values: np.ndarray, weights: ArrayLike) -> None:
        n = len(uv)
        if n < _FEWEST:
            raise TargetError(f"{n} places show no pattern; at least {_FEWEST} are needed.")
        if values.ndim == 1:
            if values.dtype.kind not in "fiub" or len(values) != n:
                raise TargetError(f"intensities have shape {values.shape}, expected {n} numbers.")
            values = values / 255 if values.dtype == np.uint8 else values.astype(np.float64)
            if not np.isfinite(values).all():
                raise TargetError(
                    "intensities are NaN or infinite; give those places a number and weight 0."
                )
        else:
            values = valid_colours(values, n)
        given = valid_weights(weights, n)
        for name, array in ("uv", uv), ("values", values), ("weights", given):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
