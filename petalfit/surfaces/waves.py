"""Sine and cosine that a compiled program computes once.

XLA takes sines for cheap, and computes them again in every loop whose result needs them: forty for the
frames of a peony petal, which has seven. It does not do so with square roots. In double precision, in
which fits run, these are therefore sin x = √(sin x + 2)² − 2, and likewise for cos, to 1e-15: frames,
foot points and derivatives of a petal take a third to a half of the time. In single precision, where
that would cost digits, they are plain.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array


@jax.custom_jvp
def sin(x: ArrayLike) -> Array:
    """Sin x."""
    return _once(jnp.sin(x))


@jax.custom_jvp
def cos(x: ArrayLike) -> Array:
    """Cos x."""
    return _once(jnp.cos(x))


@sin.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    return sin(*primals), cos(*primals) * tangents[0]


@cos.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    return cos(*primals), -sin(*primals) * tangents[0]


def _once(wave: Array) -> Array:
    if wave.dtype != jnp.float64:
        return wave
    root = jnp.sqrt(wave + 2.0)
    return root * root - 2.0
