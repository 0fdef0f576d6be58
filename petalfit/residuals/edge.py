"""The edge of a petal: how likely a point is that lies near it, and how the edge is held in place.

Points spread evenly with density ρ over a surface and blurred by Gaussian noise σ have, at a distance e
beyond a straight edge, the density ρ Φ(−e/σ). The negative logarithm of that is the edge residual; it
pushes the edge outwards. What holds the edge back is that an even spread over a larger surface makes
every point less likely: −log Area per point, whose derivative by a motion of the edge is the integral
of ρ times the conormal speed. The two balance at the truth, with no free weight.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jaxtyping import Array, Float

from petalfit.residuals.contact import frame, pull_back
from petalfit.surfaces import AbstractSurface

_REACH = 6.0  # beyond this many σ inside the edge, the edge is out of sight


def edge_residual(beyond: Float[Array, "..."]) -> Float[Array, "..."]:
    """√(−2 log Φ(−e)) for e in units of σ: 0 well inside, e far outside; smooth, with finite slope."""
    seen = beyond > -_REACH
    log_probability = log_ndtr(-jnp.where(seen, beyond, 0.0))
    return jnp.where(seen, jnp.sqrt(-2.0 * log_probability), 0.0)


def edge_score(beyond: Float[Array, "..."]) -> Float[Array, "..."]:
    """d/de of −log Φ(−e), for e in units of σ."""
    seen = beyond > -_REACH
    e = jnp.where(seen, beyond, 0.0)
    slope = jnp.exp(-0.5 * e**2 - log_ndtr(-e)) / np.sqrt(2 * np.pi)
    return jnp.where(seen, slope, 0.0)


_CELLS = 8  # per side, in which the density of points along the edge is counted
_NODES = 64  # of the midpoint rule along every side


def edge_pull(
    surface: AbstractSurface,
    uv: Float[Array, "n 2"],
    weights: Float[Array, " n"],
) -> AbstractSurface:
    """Derivative of Σ log Area by the parameters, for motions of the edge: ∮ ρ (c · ∂S/∂θ) dl.

    The density ρ is counted in the cells along the edge, so that the edge is not pulled into a hole or
    a missing half, nor by a gradient of the density.

    Args:
        surface: The surface, at the current parameters.
        uv: Foot points of the cloud.
        weights: Weight of every point; zero for padding.

    Returns:
        A pytree like `surface`.
    """
    density = _density(surface, uv, weights)
    (u_low, u_high), (v_low, v_high) = surface.domain
    fraction = (jnp.arange(_NODES) + 0.5) / _NODES
    u, v = u_low + (u_high - u_low) * fraction, v_low + (v_high - v_low) * fraction
    zero = jnp.zeros(_NODES)
    nodes = jnp.stack(
        [
            jnp.concatenate([zero + u_low, zero + u_high, u, u]),
            jnp.concatenate([v, v, zero + v_low, zero + v_high]),
        ],
        axis=-1,
    )
    here = frame(surface, nodes)
    tangent_u, tangent_v = surface.tangents(nodes[:, 0], nodes[:, 1])
    half = 2 * _NODES  # the first half of the nodes lies on u edges, the second on v edges
    conormal = jnp.concatenate([here.conormals[:half, 0], here.conormals[half:, 1]])
    speed = jnp.concatenate(
        [
            (v_high - v_low) * jnp.linalg.norm(tangent_v[:half], axis=-1),
            (u_high - u_low) * jnp.linalg.norm(tangent_u[half:], axis=-1),
        ]
    )
    along = jnp.concatenate([density[0, :], density[-1, :], density[:, 0], density[:, -1]])
    pull = jnp.repeat(along, _NODES // _CELLS) * speed / _NODES
    pulled = pull_back(surface, nodes, conormal * pull[:, None])
    return jax.tree.map(lambda leaf: jnp.sum(leaf, axis=0), pulled)


def _density(surface: AbstractSurface, uv: Array, weights: Array) -> Array:
    """Points per area in _CELLS × _CELLS cells, smooth in the points: each is shared by hat functions."""
    (u_low, u_high), (v_low, v_high) = surface.domain

    def hats(x: Array, low: float, high: float) -> Array:
        place = jnp.clip(_CELLS * (x - low) / (high - low) - 0.5, 0.0, _CELLS - 1.0)
        return jnp.maximum(0.0, 1.0 - jnp.abs(place[:, None] - jnp.arange(_CELLS)))

    counts = hats(uv[:, 0], u_low, u_high).T @ (weights[:, None] * hats(uv[:, 1], v_low, v_high))
    grid = (jnp.arange(4 * _CELLS) + 0.5) / (4 * _CELLS)
    u, v = u_low + (u_high - u_low) * grid, v_low + (v_high - v_low) * grid
    element = surface.area_element(u[:, None], v[None, :])
    area = hats(u, u_low, u_high).T @ element @ hats(v, v_low, v_high)
    return counts / (area * (u_high - u_low) * (v_high - v_low) / len(grid) ** 2)
