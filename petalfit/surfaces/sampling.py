"""Random samples of a surface, uniform by area."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from petalfit.observations import PointCloud
from petalfit.surfaces.map import AbstractMap
from petalfit.surfaces.programs import area_element, position_and_normal

# Cells of the proposal density, fine enough for the peony's midrib (1/40 of the width) and ribs.
_CELLS = (512, 128)
_MARGIN = 1.1  # ratio of the envelope to the largest area element at the corners of a cell


def sample(surface: AbstractMap, n: int, seed: int = 0, noise: float = 0.0) -> PointCloud:
    """Draws random points, uniform by area, with isotropic Gaussian noise.

    (u, v) are drawn by rejection sampling against a piecewise constant envelope of the area element, so
    the points do not lie on a grid.

    Args:
        surface: Any surface.
        n: The number of points, at least 1.
        seed: The random seed; the same seed gives the same points.
        noise: The standard deviation of every coordinate, in the unit of length, at least 0.

    Returns:
        `n` points, each with the unit normal of the surface at the point before noise.

    Raises:
        ValueError: `n` or `noise` is out of range, or the surface has no area.
    """
    if n < 1 or not (np.isfinite(noise) and noise >= 0):
        raise ValueError(f"n must be at least 1 and noise at least 0; received {n} and {noise}")
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        u, v = sample_uv(surface, n, rng).T
        points, normals = (np.asarray(x) for x in position_and_normal(surface, u, v))
    return PointCloud(points + noise * rng.standard_normal(points.shape), normals=normals)


def sample_uv(surface: AbstractMap, n: int, rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """Draws the (u, v) of `sample`. Call it inside `jax.enable_x64(True)`."""
    low, high = np.array(surface.domain).T
    u, v = (
        np.linspace(*side, cells + 1) for side, cells in zip(surface.domain, _CELLS, strict=True)
    )
    corners = np.asarray(area_element(surface, u[:, None], v[None, :]))
    envelope = _MARGIN * np.maximum.reduce(
        [corners[:-1, :-1], corners[1:, :-1], corners[:-1, 1:], corners[1:, 1:]]
    )
    cumulative = np.cumsum(envelope)
    if not cumulative[-1] > 0:
        raise ValueError(f"the surface has no area to sample: {surface}")
    accepted = np.empty((0, 2))
    while len(accepted) < n:
        # Batches of one size reuse the compiled area element; surplus places are dropped.
        batch = max(4096, 1 << (n - 1).bit_length())
        cell = np.searchsorted(cumulative, cumulative[-1] * rng.random(batch), side="right")
        cell = np.stack(np.unravel_index(np.minimum(cell, envelope.size - 1), _CELLS), axis=-1)
        uv = low + (cell + rng.random((batch, 2))) * (high - low) / _CELLS
        density = np.asarray(area_element(surface, uv[:, 0], uv[:, 1]))
        keep = rng.random(batch) * envelope[tuple(cell.T)] < density
        accepted = np.concatenate([accepted, uv[keep]])
    return accepted[:n]
