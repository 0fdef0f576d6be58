"""The likelihood of points that are spread evenly over an open surface and blurred by noise.

Every point belongs to a place p = (u, v), which may lie a little beyond the edges. The cost of a cloud is

    Σ min_p [|S(p) − x|²/2σ² + F(x_u; α_u, ρ) + F(x_v; α_v, ρ)] + N log σ + N log Area,

where x_u and x_v say how far the place is from the middle between the two edges of each coordinate, in
units of τ, α are the half widths there, and F is the potential of `petalfit.residuals.strip`: far inside,
a place is the nearest one, and across an edge the density falls like Φ(−e). The blur τ of the edges is
the noise σ where the outline follows the points, and wider where it cannot: with τ = σ, an outline of
another shape would grow until it encloses all points.

The least value over the places is smooth, and its derivatives are those at fixed places. A stationary
point can therefore be recognised.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petalfit.compilation import Program
from petalfit.fitting.coordinates import Box
from petalfit.residuals import (
    Data,
    least_places,
    potential,
    strip_potential,
)
from petalfit.surfaces import AbstractSurface, position_and_tangents

NUISANCES = 2  # coordinates after those of the parameters: log σ and log τ/σ
_ACROSS, _ALONG = 13, 33  # nodes in u and v, for widths and the area
_BEYOND = 0.25  # how far places may lie beyond the domain, in its sides
STEPS, SEARCH = 2, 5  # Newton steps of the places in an evaluation, and in a search
_SLOW = 20  # Newton steps of the few places that still move
_LOOSEST = 0.98  # the greatest ρ = σ²/τ² in the potential of the edges


class SheetCost(NamedTuple):
    """The cost −log L of a cloud at given coordinates z, and its derivatives.

    Attributes:
        cost: −log L, up to a constant.
        gradient: Its derivative by z, shape (q,).
        information: Its Gauss-Newton Hessian, with the places eliminated, shape (q, q).
        places: The places (u, v) of the points, shape (n, 2).
        each: The cost of every point, without what is common to all, shape (n,).
    """

    cost: Float[Array, ""]
    gradient: Float[Array, " q"]
    information: Float[Array, "q q"]
    places: Float[Array, "n 2"]
    each: Float[Array, " n"]


class _Noise(NamedTuple):
    """The noise σ, the blur τ of the edges, and ρ of the potential of the edges."""

    sigma: Array
    tau: Array
    rho: Array

    @classmethod
    def of(cls, z: Float[Array, " q"]) -> _Noise:
        sigma = jnp.exp(z[-2])
        return cls(sigma, sigma * jnp.exp(z[-1]), _LOOSEST * jnp.exp(-2 * z[-1]))


class Spans(NamedTuple):
    """The size of a surface between its edges.

    Attributes:
        across: The width between the u edges at nodes of v, at right angles to them, shape (_ALONG,).
        along: The width between the v edges at nodes of u, shape (_ACROSS,).
        area: The area.
    """

    across: Float[Array, " n_v"]
    along: Float[Array, " n_u"]
    area: Float[Array, ""]

    @classmethod
    def of(cls, surface: AbstractSurface) -> Spans:
        (u, u_weights), (v, v_weights) = _nodes(_ACROSS), _nodes(_ALONG)
        (u_low, u_high), (v_low, v_high) = surface.domain
        grid = np.meshgrid(
            u_low + (u_high - u_low) * u, v_low + (v_high - v_low) * v, indexing="ij"
        )
        _, (by_u, by_v) = position_and_tangents(surface, *map(jnp.asarray, grid))
        element = _norm(jnp.cross(by_u, by_v)) * (u_high - u_low) * (v_high - v_low)
        across = u_weights @ (element / (_norm(by_v) * (v_high - v_low)))
        along = (element / (_norm(by_u) * (u_high - u_low))) @ v_weights
        area = u_weights @ element @ v_weights
        return cls(jnp.asarray(across), jnp.asarray(along), jnp.asarray(area))

    def strips(
        self, places: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "2 n"], Float[Array, "2 n"]]:
        """Distances of places from the middle of the strips across and along, and their half widths.

        Args:
            places: Places as fractions of the domain's sides.
        """
        u, v = places[:, 0], places[:, 1]
        widths = jnp.stack([_between(self.across, v), _between(self.along, u)])
        return (jnp.stack([u, v]) - 0.5) * widths, 0.5 * widths


def _nodes(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes from 0 to 1, denser towards the ends, and the weights of integrals from 0 to 1."""
    turn = np.pi * np.arange(number) / (number - 1)
    # Clenshaw and Curtis: integrals of Chebyshev polynomials, which values at the nodes determine.
    order = np.arange(number)
    integrals = np.where(order % 2 == 0, 1.0 / (1.0 - order**2 + (order % 2)), 0.0)
    half = np.where((order == 0) | (order == number - 1), 0.5, 1.0)
    weights = 2 / (number - 1) * half * (np.cos(np.outer(turn, order)) @ (half * integrals))
    return 0.5 - 0.5 * np.cos(turn), weights


def _between(values: Float[Array, " m"], place: Float[Array, " n"]) -> Float[Array, " n"]:
    """Cubic interpolation between values at `_nodes`; constant beyond the ends."""
    number = len(values)
    inside = jnp.clip(place, 1e-9, 1.0 - 1e-9)
    # In the angle of the nodes they are evenly spaced, and a smooth function is even at both ends.
    t = jnp.arccos(1.0 - 2.0 * inside) * ((number - 1) / np.pi)
    k = jnp.clip(jnp.floor(t).astype(int), 0, number - 2)
    r = t - k
    before, after = values[jnp.abs(k - 1)], values[number - 1 - jnp.abs(number - 1 - (k + 2))]
    here, there = values[k], values[k + 1]
    slope, next_slope = 0.5 * (there - before), 0.5 * (after - here)
    change = there - here
    return here + r * (
        slope + r * (3 * change - 2 * slope - next_slope + r * (slope + next_slope - 2 * change))
    )


def _norm(vectors: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    return jnp.sqrt(jnp.sum(vectors**2, axis=-1) + 1e-300)


def _fractions(surface: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Places as fractions of the domain's sides."""
    low, high = (jnp.asarray(side, float) for side in zip(*surface.domain, strict=True))
    return (uv - low) / (high - low)


def _sheet_cost(
    box: Box,
    data: Data,
    z: Float[Array, " q"],
    places: Float[Array, "n 2"],
    steps: int | Int[Array, ""],
) -> SheetCost:
    """The cost of a cloud and its derivatives.

    Args:
        box: The free parameters.
        data: The cloud.
        z: Coordinates of the free parameters, log σ and log τ/σ.
        places: Starts of the places (u, v).
        steps: The number of Newton steps of the places: `STEPS` from good starts, else `SEARCH`.
    """
    own = z[:-NUISANCES]
    model, roots = box.model(own), jnp.sqrt(data.weights)
    places = _settled(model, data, _Noise.of(z), places, steps)
    here, tangents = position_and_tangents(model, places[:, 0], places[:, 1])
    gap = here - data.points
    moved = _by_coordinates(box, own, places)
    square = jnp.sum(gap**2, axis=-1)
    squares = jnp.sum(data.weights * square)

    def rest(z: Array) -> tuple[Array, Array]:
        """The cost as a function of widths, area and noise alone, at fixed positions of the places."""
        spans, noise = Spans.of(box.model(z[:-NUISANCES])), _Noise.of(z)
        each = 0.5 * square / noise.sigma**2 + _edges(model, spans, noise, places)
        constant = jnp.log(noise.sigma) + jnp.log(spans.area)
        return jnp.sum(data.weights * (each + constant)), each

    (value, each), gradient = jax.value_and_grad(rest, has_aux=True)(z)
    sigma = _Noise.of(z).sigma
    pulled = jnp.einsum("n,ni,inp->p", data.weights, gap, moved) / sigma**2
    gradient = gradient.at[:-NUISANCES].add(pulled)
    both = _Linear(moved * roots[:, None], jnp.swapaxes(tangents, 1, 2) * roots, squares)
    return SheetCost(value, gradient, _information(box, data, z, places, both), places, each)


def _edges(
    model: AbstractSurface, spans: Spans, noise: _Noise, places: Float[Array, "n 2"]
) -> Float[Array, " n"]:
    """The potential of the edges at every place."""
    x, half = spans.strips(_fractions(model, places))
    return jnp.sum(strip_potential(x / noise.tau, half / noise.tau, noise.rho), axis=0)


def _settled(
    model: AbstractSurface,
    data: Data,
    noise: _Noise,
    places: Float[Array, "n 2"],
    steps: int | Int[Array, ""],
) -> Float[Array, "n 2"]:
    """The places of least cost of all points, near given ones."""
    spans = Spans.of(model)
    low, high = (jnp.asarray(side, float) for side in zip(*model.domain, strict=True))
    low, high = low - _BEYOND * (high - low), high + _BEYOND * (high - low)

    def run(start: Array, points: Array, steps: int | Array) -> tuple[Array, Array]:
        def expand(places: Array) -> tuple[Array, Array, Array]:
            return _expansion(model, spans, noise, points, places)

        found, doubt, _ = least_places(expand, start, steps, low, high)
        return found, doubt

    found, doubt = run(places, data.points, steps)
    _, slow = jax.lax.top_k(doubt, min(len(found), max(32, len(found) // 64)))
    return found.at[slow].set(run(found[slow], data.points[slow], _SLOW)[0])


def _expansion(
    model: AbstractSurface, spans: Spans, noise: _Noise, points: Array, places: Array
) -> tuple[Array, Array, Array]:
    """The cost of every point at its place, with the gradient and the Hessian by the place."""
    position, tangents = position_and_tangents(model, places[:, 0], places[:, 1])
    gap = position - points
    value = 0.5 * jnp.sum(gap**2, axis=-1)
    gradient = jnp.einsum("kni,ni->nk", tangents, gap)
    # Gauss-Newton: the bending of the surface within the noise hardly counts.
    hessian = jnp.einsum("kni,lni->nkl", tangents, tangents)
    x, half, by_place, widening = _strips(model, spans, noise, places)
    here = potential(x, half, noise.rho)
    slope = here.slope[..., None] * by_place + here.by_width[..., None] * widening
    # Near an edge F depends on the distance beyond it alone.
    beyond = by_place - _side(x)[..., None] * widening
    variance = noise.sigma**2
    return (
        value / variance + jnp.sum(here.value, axis=0),
        gradient / variance + jnp.sum(slope, axis=0),
        hessian / variance + jnp.einsum("kn,kni,knj->nij", here.curvature, beyond, beyond),
    )


def _side(x: Float[Array, "2 n"]) -> Float[Array, "2 n"]:
    """The side of the nearer edge: −1 or 1."""
    return jnp.where(x < 0, -1.0, 1.0)


def _strips(
    model: AbstractSurface, spans: Spans, noise: _Noise, places: Float[Array, "n 2"]
) -> tuple[Array, Array, Array, Array]:
    """For both strips x and α in units of τ, shape (2, n), and their derivatives by the place."""

    def strips(places: Array) -> tuple[Array, Array]:
        x, half = spans.strips(_fractions(model, places))
        return x / noise.tau, half / noise.tau

    along = [
        jax.jvp(strips, (places,), (jnp.broadcast_to(jnp.asarray(axis), places.shape),))[1]
        for axis in np.eye(2)
    ]
    by_place, widening = (jnp.stack(both, axis=-1) for both in zip(*along, strict=True))
    return *strips(places), by_place, widening


class _Linear(NamedTuple):
    """Derivatives of the positions of places, times the roots of the weights of their points.

    Attributes:
        by_z: By the coordinates of the free parameters, shape (3, n, p).
        by_place: By u and v, shape (2, 3, n).
        squares: The weighted sum of the squared distances of points and places.
    """

    by_z: Float[Array, "3 n p"]
    by_place: Float[Array, "2 3 n"]
    squares: Float[Array, ""]


def _information(
    box: Box, data: Data, z: Float[Array, " q"], places: Float[Array, "n 2"], linear: _Linear
) -> Float[Array, "q q"]:
    """The Gauss-Newton Hessian of the cost by z, with the places eliminated.

    It is the sum over all points of A_zz − A_zp A_pp⁻¹ A_pz, where A = JᵀJ has a row for each component
    of S/σ, and one for each strip, √F'' times the distance beyond its nearer edge.
    """
    own, noise = z[:-NUISANCES], _Noise.of(z)
    model = box.model(own)
    spans, roots = Spans.of(model), jnp.sqrt(data.weights)
    x, half, by_x, widening = _strips(model, spans, noise, places)
    side = _side(x)
    # The distance beyond the nearer edge is proportional to the width of the strip.
    grown = _widened(box, own)
    u, v = jnp.unstack(_fractions(model, places), axis=1)
    widened = [jax.vmap(_between, (1, None), 1)(*pair) for pair in zip(grown, (v, u), strict=True)]
    share = jnp.stack([u, v]) - 0.5 - 0.5 * side
    root = roots * jnp.sqrt(potential(x, half, noise.rho).curvature)
    blur = jnp.broadcast_to((side * half - x)[..., None], (*x.shape, NUISANCES))
    edges = share[..., None] * jnp.stack(widened) / noise.tau
    edges = jnp.concatenate([edges, blur], axis=-1) * root[..., None]
    none = jnp.zeros((*linear.by_z.shape[:2], NUISANCES))
    by_z = jnp.concatenate([jnp.concatenate([linear.by_z / noise.sigma, none], axis=-1), edges])
    across = (by_x - side[..., None] * widening) * root[..., None]
    by_p = jnp.concatenate([linear.by_place.transpose(1, 2, 0) / noise.sigma, across])
    a_pp = jnp.einsum("kni,knj->nij", by_p, by_p)
    a_pz = jnp.einsum("kni,knq->niq", by_p, by_z)
    rows = by_z.reshape(-1, by_z.shape[-1])
    bound = a_pz.reshape(-1, a_pz.shape[-1])
    solved = (_inverse(a_pp) @ a_pz).reshape(bound.shape)
    squares = linear.squares / noise.sigma**2
    return (rows.T @ rows - bound.T @ solved).at[-2, -2].add(2 * squares)


def _widened(box: Box, own: Float[Array, " p"]) -> tuple[Float[Array, "m p"], Float[Array, "k p"]]:
    """Derivatives of the widths across and along at the nodes of `Spans` by the coordinates.

    Tangents are differentiated as polynomials through the nodes, which is less exact than `Spans` where
    the slope of an outline has a kink, and takes a tenth of the time. Only the Hessian depends on it.
    """
    model = box.model(own)
    (u, u_weights), (v, v_weights) = _nodes(_ACROSS), _nodes(_ALONG)
    (u_low, u_high), (v_low, v_high) = model.domain
    grid = np.meshgrid(u_low + (u_high - u_low) * u, v_low + (v_high - v_low) * v, indexing="ij")
    nodes = np.stack([side.ravel() for side in grid], axis=-1)
    _, (by_u, by_v) = position_and_tangents(model, *map(jnp.asarray, grid))
    by_u, by_v = by_u * (u_high - u_low), by_v * (v_high - v_low)
    moved = _by_coordinates(box, own, jnp.asarray(nodes)).reshape(3, _ACROSS, _ALONG, -1)
    moved_u = jnp.einsum("ab,cbvp->avpc", _differences(u), moved)
    moved_v = jnp.einsum("ab,cubp->uapc", _differences(v), moved)
    area = jnp.cross(by_u, by_v)
    element, long_u, long_v = _norm(area), _norm(by_u), _norm(by_v)
    normal = area / element[..., None]
    # Derivatives of the element of area, by the rule for (a × b)·n, and of the lengths of the tangents.
    grown = jnp.einsum("uvpc,uvc->uvp", moved_u, jnp.cross(by_v, normal))
    grown = grown + jnp.einsum("uvpc,uvc->uvp", moved_v, jnp.cross(normal, by_u))
    longer_u = jnp.einsum("uvpc,uvc->uvp", moved_u, by_u / long_u[..., None])
    longer_v = jnp.einsum("uvpc,uvc->uvp", moved_v, by_v / long_v[..., None])
    across = (grown - (element / long_v)[..., None] * longer_v) / long_v[..., None]
    along = (grown - (element / long_u)[..., None] * longer_u) / long_u[..., None]
    return jnp.einsum("u,uvp->vp", u_weights, across), jnp.einsum("v,uvp->up", v_weights, along)


def _differences(nodes: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m m"]:
    """The matrix that differentiates the polynomial through values at Chebyshev nodes."""
    weights = (-1.0) ** np.arange(len(nodes))
    weights[[0, -1]] *= 0.5
    apart = nodes[:, None] - nodes + np.eye(len(nodes))
    matrix = weights / weights[:, None] / apart
    np.fill_diagonal(matrix, 0.0)
    return matrix - np.diag(matrix.sum(axis=1))


def _inverse(matrix: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """Inverses of symmetric 2 × 2 matrices."""
    a, b, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]
    adjugate = jnp.stack([jnp.stack([d, -b], axis=-1), jnp.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b**2 + 1e-300)[:, None, None]


def _by_coordinates(
    box: Box, own: Float[Array, " p"], places: Float[Array, "n 2"]
) -> Float[Array, "3 n p"]:
    """Derivatives of the positions of places by the coordinates of the free parameters."""
    model = box.model(own)

    def component(axis: Array) -> Array:
        def along(model: AbstractSurface, place: Array) -> Array:
            return jnp.sum(axis * model.position(place[0], place[1]))

        return box.gather(jax.vmap(jax.grad(along), (None, 0))(model, places))

    return jax.vmap(component)(jnp.eye(3)) * box.slopes(own)


sheet_cost = Program(_sheet_cost)
