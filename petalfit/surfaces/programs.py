"""The compiled programs of sampling and tessellation."""

from __future__ import annotations

from jaxtyping import Array

from petalfit.compilation import Program
from petalfit.surfaces.surface import AbstractSurface


def _position_and_normal(surface: AbstractSurface, u: Array, v: Array) -> tuple[Array, Array]:
    return surface(u, v), surface.normal(u, v)


def _area_element(surface: AbstractSurface, u: Array, v: Array) -> Array:
    return surface.area_element(u, v)


position_and_normal = Program(_position_and_normal)
area_element = Program(_area_element)
