"""The compiled programs of sampling, tessellation and outlines."""

from __future__ import annotations

from jaxtyping import Array

from petalfit.compilation import Program
from petalfit.surfaces.map import AbstractMap


def _position_and_normal(surface: AbstractMap, u: Array, v: Array) -> tuple[Array, Array]:
    return surface(u, v), surface.normal(u, v)


def _grid_positions(surface: AbstractMap, u: Array, v: Array) -> Array:
    return surface(u[:, None], v[None, :])


def _area_element(surface: AbstractMap, u: Array, v: Array) -> Array:
    return surface.area_element(u, v)


position_and_normal = Program(_position_and_normal)
grid_positions = Program(_grid_positions)
area_element = Program(_area_element)
