"""The colour of an organ: a palette and the patterns that mix its colours."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real, UInt8

from petalfit.colours.pattern import AbstractPattern
from petalfit.colours.srgb import from_hex, to_linear, to_srgb
from petalfit.compilation import Program


class Colour(eqx.Module):
    """A ground colour, over which patterns lay the further colours of a palette one after the other.

    The intensity of a pattern, clipped to [0, 1], is the opacity of its colour. Colours are mixed in
    linear light, not in sRGB.

    Attributes:
        palette: The colours, sRGB in [0, 1], shape (1 + number of patterns, 3); the ground comes first.
        patterns: One pattern for every further colour, in the order of the palette.
    """

    palette: Float[Array | np.ndarray, "k 3"]
    patterns: tuple[AbstractPattern, ...] = ()

    def __check_init__(self) -> None:
        if self.palette.shape[0] != 1 + len(self.patterns):
            raise ValueError(
                f"a palette has a ground and a colour for every pattern, {1 + len(self.patterns)} here; "
                f"received {self.palette.shape[0]}"
            )

    @classmethod
    def of(cls, *colours: str, patterns: tuple[AbstractPattern, ...] = ()) -> Colour:
        """A colour from CSS notations such as "#f6d9e2"; the ground comes first."""
        return cls(np.stack([from_hex(colour) for colour in colours]), patterns)

    @property
    def is_plain(self) -> bool:
        """Whether the ground is the only colour."""
        return not self.patterns

    def __call__(
        self, u: Real[ArrayLike, "..."], v: Real[ArrayLike, "..."]
    ) -> Float[Array, "... 3"]:
        """Linear RGB in [0, 1] at (u, v); the shape is the broadcast shape of u and v followed by 3."""
        ground, *marks = to_linear(self.palette)
        shape = jnp.broadcast_shapes(jnp.shape(u), jnp.shape(v))
        mixed = jnp.broadcast_to(ground, (*shape, 3))
        for pattern, mark in zip(self.patterns, marks, strict=True):
            cover = jnp.clip(pattern(u, v), 0.0, 1.0)[..., None]
            mixed = mixed + cover * (mark - mixed)
        return mixed

    def texture(self, shape: tuple[int, int] = (256, 256)) -> UInt8[np.ndarray, "h w 3"]:
        """The colours at pixel centres as an sRGB picture, u to the right and the tip (v = 1) on top.

        Args:
            shape: The height and the width in pixels.
        """
        height, width = shape
        u = (np.arange(width) + 0.5) / width - 0.5
        v = 1 - (np.arange(height) + 0.5) / height
        with jax.enable_x64(True):
            srgb = np.asarray(_picture(self, u[None, :], v[:, None]))
        return np.rint(255 * srgb).astype(np.uint8)


def _srgb(colour: Colour, u: Array, v: Array) -> Array:
    return to_srgb(colour(u, v))


_picture = Program(_srgb)
