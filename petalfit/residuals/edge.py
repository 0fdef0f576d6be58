"""The likelihood of points near the edge of a petal, and the term that balances it.

Points spread evenly with density ρ over a surface and blurred by Gaussian noise σ have, at a distance e
beyond a straight edge, the density ρ Φ(−e/σ). Its negative logarithm is the edge residual, which pushes
the edge outwards. The balance comes from the area: an even spread over a larger surface makes every point
less likely, by −log Area per point, whose derivative by a motion of the edge is the integral of ρ times
the conormal speed. The two terms balance at the truth, without a free weight.

Where the width w of the surface is not large compared with σ, both edges affect every point: the density
Φ(−e₁/σ) Φ(−e₂/σ) has the integral Z(w) = w Φ(a) + √2 σ φ(a), a = w/√2σ, across the width, and log Z
replaces log w. Otherwise a pointed end could always be made more likely by making it narrower.

The functions take arrays of NumPy, and of jax where a fit is differentiated, and return the same kind.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.special
import numpy as np
import scipy.special
from jaxtyping import Float

from petalfit.residuals.contact import Frame, Numbers
from petalfit.surfaces import AbstractSurface, Domain


def _namespace(x: Numbers) -> tuple[Any, Any]:
    """The functions for arrays of the kind of x, and the special ones."""
    if isinstance(x, jax.Array):
        return jnp, jax.scipy.special
    return np, scipy.special


_REACH = 6.0  # in σ; points farther inside than this do not feel the edge
_FAR = 1e3  # in σ; farther outside, e²/2 and log Φ(−e) would cancel each other out


def edge_residual(beyond: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
    """√(−2 log Φ(−e)), e in units of σ: 0 far inside, e far outside; smooth, with a finite slope."""
    xp, special = _namespace(beyond)
    seen = beyond > -_REACH
    log_probability = special.log_ndtr(-xp.where(seen, beyond, 0.0))
    return xp.where(seen, xp.sqrt(-2.0 * log_probability), 0.0)


def edge_score(beyond: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
    """The derivative of −log Φ(−e) by e, for e in units of σ."""
    xp, special = _namespace(beyond)
    seen, far = beyond > -_REACH, beyond > _FAR
    e = xp.where(seen & ~far, beyond, 0.0)
    slope = xp.exp(-0.5 * e**2 - special.log_ndtr(-e)) / np.sqrt(2 * np.pi)
    remote = xp.where(far, beyond, 1.0)
    return xp.where(far, remote + 1 / remote, xp.where(seen, slope, 0.0))


_CELLS = 8  # cells per side, in which the density of points along the edge is counted
_NODES = 64  # nodes of the midpoint rule along every side
_GRID = 32  # nodes per side of the midpoint rule for the areas of the cells
EDGE_NODES = 4 * _NODES


def edge_nodes(domain: Domain) -> Float[np.ndarray, "m 2"]:
    """The places at which `edge_pull` needs frames: `EDGE_NODES` along the edge, then a grid."""
    low, high = np.array(domain).T
    along, zero, grid = _midpoints(_NODES), np.zeros(_NODES), _midpoints(_GRID)
    sides = [(zero, along), (zero + 1, along), (along, zero), (along, zero + 1)]
    cells = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    places = np.concatenate([*(np.stack(side, axis=-1) for side in sides), cells])
    return low + (high - low) * places


def _counted(beyond: Any) -> Any:
    """The share with which a point counts in the density that holds an edge back, for e in units of σ.

    Noise moves hardly any point farther than 2σ beyond an edge. Points that lie there show that the edge
    has to move, and their foot points accumulate on the edge; counted as density they would hold it in
    place.
    """
    return _namespace(beyond)[1].ndtr(2.0 * (1.5 - beyond))


def blurred_width(
    width: Float[Numbers, "*shape"], sigma: float | Float[Numbers, ""]
) -> tuple[Float[Numbers, "*shape"], Float[Numbers, "*shape"]]:
    """Z(w), the width w blurred by σ, and its derivative Φ(w/√2σ)."""
    xp, special = _namespace(width)
    a = width / (np.sqrt(2) * sigma)
    share = special.ndtr(a)
    return width * share + sigma * xp.exp(-0.5 * a**2) / np.sqrt(np.pi), share


def edge_pull(
    surface: AbstractSurface,
    here: Frame,
    uv: Float[Numbers, "n 2"],
    weights: Float[Numbers, " n"],
    beyond: Float[Numbers, " n"],
    sigma: float | Float[Numbers, ""],
) -> Float[Numbers, "m 3"]:
    """The derivative of Σ log Area by a motion of the edge, as covectors w at places on the edge.

    They satisfy Σ w·∂S/∂θ = ∮ ρ (c · ∂S/∂θ) dl, with c the conormal. The density ρ is counted in the
    cells along the edge, so that neither a hole, a missing half nor a gradient of the density pulls the
    edge.

    Args:
        surface: The surface, of which the domain and the edges are used.
        here: The frames of the surface at `edge_nodes`.
        uv: The foot points of the cloud.
        weights: The weight of every point.
        beyond: The distance of every point beyond the nearest edge, in units of σ, negative inside.
        sigma: The noise, which reduces ρ where the surface is narrow.

    Returns:
        A covector for each of the first `EDGE_NODES` nodes.
    """
    domain, (xp, _) = surface.domain, _namespace(uv)
    grid = Frame(*(x[EDGE_NODES:] for x in here))
    density = _density(domain, grid.area_element, uv, weights * _counted(beyond))
    by_u, by_v = (_narrowed(width, sigma) for width in _widths(domain, grid))
    along = xp.concatenate(
        [density[0, :] * by_u, density[-1, :] * by_u, density[:, 0] * by_v, density[:, -1] * by_v]
    )
    # The first half of the nodes lies on u edges, the second on v edges.
    half = EDGE_NODES // 2
    conormals = xp.concatenate([here.conormals[:half, 0], here.conormals[half:EDGE_NODES, 1]])
    speed = xp.concatenate([here.speed[:half, 1], here.speed[half:EDGE_NODES, 0]])
    (u_low, u_high), (v_low, v_high) = domain
    length = np.repeat([v_high - v_low, u_high - u_low], half)
    pull = xp.repeat(along, _NODES // _CELLS) * length * speed / _NODES
    pull = pull * np.repeat(np.asarray(surface.edges, float), half)
    return conormals * pull[:, None]


def _density(domain: Domain, element: Any, uv: Any, weights: Any) -> Any:
    """Points per area in _CELLS × _CELLS cells; hat functions divide each point smoothly among cells."""
    (low, high), (xp, _) = np.array(domain).T, _namespace(uv)

    def hats(fraction: Any) -> Any:
        place = xp.clip(_CELLS * fraction - 0.5, 0.0, _CELLS - 1.0)
        return xp.maximum(0.0, 1.0 - abs(place[..., None] - np.arange(_CELLS)))

    shares = hats((uv - low) / (high - low))
    counts = shares[:, 0].T @ (weights[:, None] * shares[:, 1])
    weight = hats(_midpoints(_GRID))
    area = weight.T @ element.reshape(_GRID, _GRID) @ weight
    return counts / (area * np.prod(high - low) / _GRID**2)


def _widths(domain: Domain, grid: Frame) -> tuple[Any, Any]:
    """The widths between the u edges in every cell of v, and between the v edges in every cell of u."""
    ranges, (xp, _) = np.ptp(np.array(domain), axis=1), _namespace(grid.speed)
    element = grid.area_element.reshape(_GRID, _GRID)
    speed = grid.speed.reshape(_GRID, _GRID, 2)
    u_speed, v_speed = speed[..., 0], speed[..., 1]

    def by_cell(x: Any, axis: int) -> Any:
        return x.sum(axis=axis).reshape(_CELLS, -1).sum(axis=-1)

    return (
        ranges[0] * by_cell(element, 0) / xp.maximum(by_cell(v_speed, 0), 1e-300),
        ranges[1] * by_cell(element, 1) / xp.maximum(by_cell(u_speed, 1), 1e-300),
    )


def _narrowed(width: Any, sigma: Any) -> Any:
    """The factor w d(log Z)/dw: 1 where a surface is wide compared with σ, 0 where it has no width."""
    blurred, slope = blurred_width(width, sigma)
    return width * slope / blurred


def _midpoints(n: int) -> np.ndarray:
    return (np.arange(n) + 0.5) / n
