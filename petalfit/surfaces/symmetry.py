"""Symmetries of a surface, which leave parameters of a pose undetermined."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array

from petalfit.compilation import Program
from petalfit.surfaces.map import AbstractMap
from petalfit.surfaces.pose import about_y

_TURN = 0.7  # rad; any angle that is not a simple fraction of a turn
_EQUAL = 1e-9  # tolerance, relative to the surface's size


def is_of_revolution(surface: AbstractMap) -> bool:
    """Whether rotations about the y axis map the surface onto itself, as a shift of u or of v."""
    low, high = np.array(surface.domain).T
    u, v = (low + (high - low) * np.linspace(0.1, 0.9, 9)[:, None]).T
    with jax.enable_x64(True):
        here = np.asarray(_place(surface, u, v))
        for along, ends in zip(np.eye(2), surface.edges, strict=True):
            if ends:
                continue
            turned = np.asarray(_place(surface, u + _TURN * along[0], v + _TURN * along[1]))
            for angle in (_TURN, -_TURN):
                gap = np.abs(here @ np.asarray(about_y(angle)).T - turned).max()
                if gap <= _EQUAL * np.abs(here).max():
                    return True
    return False


def _position(surface: AbstractMap, u: Array, v: Array) -> Array:
    return surface(u, v)


_place = Program(_position)
