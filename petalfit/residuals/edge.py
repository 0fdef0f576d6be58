"""The edge of a petal: how likely a point is that lies near it, and how the edge is held in place.

Points spread evenly with density ρ over a surface and blurred by Gaussian noise σ have, at a distance e
beyond a straight edge, the density ρ Φ(−e/σ). The negative logarithm of that is the edge residual; it
pushes the edge outwards. What holds the edge back is that an even spread over a larger surface makes
every point less likely: −log Area per point, whose derivative by a motion of the edge is the integral
of ρ times the conormal speed. The two balance at the truth, with no free weight.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jaxtyping import Array, Float

from petalfit.residuals.contact import Frame
from petalfit.surfaces import AbstractSurface, Domain

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
_GRID = 32  # per side, of the midpoint rule for the cells' areas
EDGE_NODES = 4 * _NODES


def edge_nodes(domain: Domain) -> Float[np.ndarray, "m 2"]:
    """Where `edge_pull` wants the frames: `EDGE_NODES` places along the edge, then a grid."""
    low, high = np.array(domain).T
    along, zero, grid = _midpoints(_NODES), np.zeros(_NODES), _midpoints(_GRID)
    sides = [(zero, along), (zero + 1, along), (along, zero), (along, zero + 1)]
    cells = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    places = np.concatenate([*(np.stack(side, axis=-1) for side in sides), cells])
    return low + (high - low) * places


def edge_pull(
    surface: AbstractSurface, here: Frame, uv: Float[Array, "n 2"], weights: Float[Array, " n"]
) -> Float[Array, "m 3"]:
    """Covectors w with Σ w·∂S/∂θ = ∮ ρ (c · ∂S/∂θ) dl, the derivative of Σ log Area by a moving edge.

    The density ρ is counted in the cells along the edge, so that the edge is not pulled into a hole or
    a missing half, nor by a gradient of the density.

    Args:
        surface: Its domain and its edges count.
        here: The surface's frames at `edge_nodes`.
        uv: Foot points of the cloud.
        weights: Weight of every point; zero for padding.

    Returns:
        A covector for each of the first `EDGE_NODES` nodes.
    """
    domain = surface.domain
    density = _density(domain, here.area_element[EDGE_NODES:], uv, weights)
    along = jnp.concatenate([density[0, :], density[-1, :], density[:, 0], density[:, -1]])
    # The first half of the nodes lies on u edges, the second on v edges.
    half = EDGE_NODES // 2
    conormals = jnp.concatenate([here.conormals[:half, 0], here.conormals[half:EDGE_NODES, 1]])
    speed = jnp.concatenate([here.speed[:half, 1], here.speed[half:EDGE_NODES, 0]])
    (u_low, u_high), (v_low, v_high) = domain
    length = np.repeat([v_high - v_low, u_high - u_low], half)
    pull = jnp.repeat(along, _NODES // _CELLS) * length * speed / _NODES
    pull = pull * np.repeat(np.asarray(surface.edges, float), half)
    return conormals * pull[:, None]


def _density(domain: Domain, element: Array, uv: Array, weights: Array) -> Array:
    """Points per area in _CELLS × _CELLS cells, smooth in the points: each is shared by hat functions."""
    low, high = np.array(domain).T

    def hats(fraction: Array | np.ndarray) -> Array:
        place = jnp.clip(_CELLS * fraction - 0.5, 0.0, _CELLS - 1.0)
        return jnp.maximum(0.0, 1.0 - jnp.abs(place[..., None] - np.arange(_CELLS)))

    shares = hats((uv - low) / (high - low))
    counts = shares[:, 0].T @ (weights[:, None] * shares[:, 1])
    weight = hats(_midpoints(_GRID))
    area = weight.T @ element.reshape(_GRID, _GRID) @ weight
    return counts / (area * np.prod(high - low) / _GRID**2)


def _midpoints(n: int) -> np.ndarray:
    return (np.arange(n) + 0.5) / n
