"""The compiled programs of a cloud fit: few, small and shared, because a first fit waits for them."""

from __future__ import annotations

import jax
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.fitting import solve as _solve
from petalfit.fitting import survey as _survey
from petalfit.residuals import nearest_nodes, refine_foot_points
from petalfit.surfaces import AbstractSurface


def _positions(surfaces: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "k n 3"]:
    """Places of a batch of surfaces, whose leaves have shape (k,)."""
    return jax.vmap(lambda surface: surface.position(uv[:, 0], uv[:, 1]))(surfaces)


positions = Program(_positions)
nearest = Program(nearest_nodes)
refine = Program(refine_foot_points)
survey = Program(_survey.survey)
solve = Program(_solve.solve)
