"""Sine and cosine that a compiled program computes only once.

XLA considers sines cheap and recomputes them in every loop that needs them: forty times for the frames of
a peony petal, which has seven. It does not do so with square roots. In double precision, in which fits
run, sin x is therefore computed as √(sin x + 2)² − 2, and cos x likewise, to 1e-15; frames, foot points
and derivatives of a petal then take a third to a half of the time. In single precision this would cost
digits, so there they are computed plainly.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array


@jax.custom_jvp
def sin(x: ArrayLike) -> Array:
    """The sine of x, in the form that the module describes."""
    return _once(jnp.sin(x))


@jax.custom_jvp
def cos(x: ArrayLike) -> Array:
    """The cosine of x, in the form that the module describes."""
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
