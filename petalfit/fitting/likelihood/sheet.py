"""The likelihood of points that are spread evenly over an open surface and blurred by noise.

Every point belongs to a place p = (u, v), which may lie a little beyond the edges. The cost of a cloud is

    Σ min_p [|S(p) − x|²/2σ² + F(x_u; α_u, ρ) + F(x_v; α_v, ρ)] + N log σ + N log Area,

where x_u and x_v say how far the place is from the middle between the two edges of each coordinate, in
units of τ, α are the half widths there, and F is the potential of `petalfit.residuals.strip`: far inside,
a place is the nearest one, and across an edge the density falls like Φ(−e). The blur τ of the edges is
the noise σ where the outline follows the points, and wider where it cannot: with τ = σ, an outline of
another shape would grow until it encloses all points.

An outline that cannot follow the points must neither cut many off nor enclose much that is empty: the
cost of `petalfit.fitting.likelihood.emptiness` is added.

The least value over the places is smooth, and its derivatives are those at fixed places. A stationary
point can therefore be recognised. Points go through in blocks of one size, so that a cloud of any size
needs the same two programs.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petalfit.compilation import Program, blocks
from petalfit.fitting.coordinates import Box
from petalfit.fitting.likelihood.emptiness import Emptiness
from petalfit.fitting.likelihood.foot_points import beside, distances
from petalfit.fitting.likelihood.spans import Spans, between, by_coordinates, spans_of
from petalfit.residuals import least_places, nearest_nodes, potential, slide_foot_points
from petalfit.surfaces import AbstractSurface, position_and_tangents

NUISANCES = 2  # coordinates after those of the parameters: log σ and log τ/σ
STEPS, SEARCH = 2, 5  # Newton steps of the places in an evaluation, and in a search
_BEYOND = 0.25  # how far places may lie beyond the domain, in its sides
_LOOSEST = 0.98  # the greatest ρ = σ²/τ² in the potential of the edges


class SheetCost(NamedTuple):
    """The cost −log L of a cloud, or of a block of it, at coordinates z, and its derivatives.

    Attributes:
        cost: −log L, up to a constant.
        gradient: Its derivative by z, shape (q,).
        information: Its Gauss-Newton Hessian, with the places eliminated, shape (q, q).
        places: The places (u, v) of the points, shape (n, 2).
        following: The derivatives of the places by z, shape (n, 2, q).
        each: The cost of every point, without what is common to all, shape (n,).
    """

    cost: Float[Array | np.ndarray, ""]
    gradient: Float[Array | np.ndarray, " q"]
    information: Float[Array | np.ndarray, "q q"]
    places: Float[Array | np.ndarray, "n 2"]
    following: Float[Array | np.ndarray, "n 2 q"]
    each: Float[Array | np.ndarray, " n"]


_SUMS, _ROWS = SheetCost._fields[:3], SheetCost._fields[3:]


@dataclasses.dataclass(frozen=True, eq=False)
class Sheet:
    """The likelihood of a cloud. Call its methods inside `jax.enable_x64(True)`.

    Attributes:
        points: The points, shape (n, 3).
        weights: The number of observations that each point counts for, shape (n,).
    """

    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]

    @property
    def whole(self) -> Sheet:
        """The likelihood of all points, where these stand for more of them."""
        return self

    def cost(
        self,
        box: Box,
        z: Float[np.ndarray, " q"],
        places: Float[np.ndarray, "m 2"],
        steps: int,
    ) -> SheetCost:
        """The cost of the cloud and its derivatives.

        Args:
            box: The free parameters.
            z: Coordinates of the free parameters, log σ and log τ/σ.
            places: Starts of the places (u, v) of all points, with those of the padding.
            steps: The number of Newton steps of the places: `STEPS` from good starts, else `SEARCH`.
        """
        spans, slopes, outline, moved = spans_of(box, z[:-NUISANCES])
        parts = zip(self._blocks, self._weights, blocks(places), strict=True)
        calls = [(box, spans, slopes, *part, z, uv, steps) for *part, uv in parts]
        found = [SheetCost(*map(np.asarray, part)) for part in _block_cost.map(calls)]
        cost, gradient, information = (
            np.sum([getattr(part, name) for part in found], axis=0) for name in _SUMS
        )
        tau = float(np.exp(np.sum(z[-NUISANCES:])))
        empty = self._emptiness.cost(np.asarray(outline), np.asarray(moved), tau)
        gradient += np.append(empty[1], np.full(NUISANCES, -2 * empty[0]))
        information[:-NUISANCES, :-NUISANCES] += empty[2]
        information[-NUISANCES:, -NUISANCES:] += 4 * empty[0]
        rows = (np.concatenate([getattr(part, name) for part in found]) for name in _ROWS)
        return SheetCost(cost + empty[0], gradient, information, *rows)

    def nearest(self, surface: AbstractSurface) -> Float[np.ndarray, "m 2"]:
        """Coarse places of all points and of the padding: the nearest of 17 × 17 nodes."""
        return nearest_nodes(surface, np.concatenate(self._blocks))

    def spread(self, surface: AbstractSurface, places: Float[np.ndarray, "m 2"]) -> float:
        """The root mean square distance of the points from places on a surface."""
        square = distances(surface, self.points, places[: len(self.points)]) ** 2
        return float(np.sqrt(np.average(square, weights=self.weights) + 1e-300))

    def beside(
        self, surface: AbstractSurface, places: Float[np.ndarray, "m 2"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """Signed normal distances, distances beyond the edge (negative inside), and foot points.

        Args:
            surface: The surface.
            places: Places near the foot points, with those of the padding.
        """
        start = np.clip(places[: len(self.points)], *np.array(surface.domain).T)
        uv, _, _ = slide_foot_points(surface, self.points, start, SEARCH)
        return *beside(surface, self.points, uv), uv

    @cached_property
    def _emptiness(self) -> Emptiness:
        return Emptiness.of(self.points, self.weights)

    @cached_property
    def padded_weights(self) -> Float[np.ndarray, " m"]:
        """The weights, and zeros for the padding."""
        return np.concatenate(self._weights)

    @cached_property
    def _blocks(self) -> list[np.ndarray]:
        return blocks(self.points)

    @cached_property
    def _weights(self) -> list[np.ndarray]:
        return blocks(self.weights, 0.0)


class _Noise(NamedTuple):
    """The noise σ, the blur τ of the edges, and ρ of the potential of the edges."""

    sigma: Array
    tau: Array
    rho: Array

    @classmethod
    def of(cls, z: Float[Array, " q"]) -> _Noise:
        sigma = jnp.exp(z[-2])
        return cls(sigma, sigma * jnp.exp(z[-1]), _LOOSEST * jnp.exp(-2 * z[-1]))


class _Strips(NamedTuple):
    """The strips across and along at some places, in units of τ, with derivatives by the places.

    Attributes:
        x: Distances of the places from the middle of both strips, shape (2, n).
        half: Half the widths of the strips there, shape (2, n).
        by_place: Derivatives of x by (u, v), shape (2, n, 2).
        widening: Derivatives of `half` by (u, v), shape (2, n, 2).
        share: Distances from the middle, as fractions of the widths, shape (2, n).
    """

    x: Float[Array, "2 n"]
    half: Float[Array, "2 n"]
    by_place: Float[Array, "2 n 2"]
    widening: Float[Array, "2 n 2"]
    share: Float[Array, "2 n"]

    @classmethod
    def of(
        cls, model: AbstractSurface, spans: Spans, tau: Array, places: Float[Array, "n 2"]
    ) -> _Strips:
        low, high = (jnp.asarray(side, float) for side in zip(*model.domain, strict=True))
        u, v = jnp.unstack((places - low) / (high - low), axis=1)
        across, wider = between(spans.across, v)
        along, longer = between(spans.along, u)
        none, widths = jnp.zeros_like(u), jnp.stack([across, along])
        share = jnp.stack([u, v]) - 0.5
        widening = jnp.stack([jnp.stack([none, wider], -1), jnp.stack([longer, none], -1)])
        own = jnp.stack([jnp.stack([across, none], -1), jnp.stack([none, along], -1)])
        unit = tau * (high - low)
        by_place = (own + share[..., None] * widening) / unit
        return cls(share * widths / tau, 0.5 * widths / tau, by_place, 0.5 * widening / unit, share)

    @property
    def side(self) -> Float[Array, "2 n"]:
        """The side of the nearer edge: −1 or 1."""
        return jnp.where(self.x < 0, -1.0, 1.0)

    @property
    def beyond(self) -> Float[Array, "2 n 2"]:
        """Derivatives of the distance beyond the nearer edge by (u, v), times the side."""
        return self.by_place - self.side[..., None] * self.widening


def _cost(
    box: Box,
    spans: Spans,
    slopes: Spans,
    points: Float[Array, "n 3"],
    weights: Float[Array, " n"],
    z: Float[Array, " q"],
    places: Float[Array, "n 2"],
    steps: int | Int[Array, ""],
) -> SheetCost:
    """The cost of a block and its derivatives. See `Sheet.cost`.

    The information is the sum over all points of A_zz − A_zp A_pp⁻¹ A_pz, where A = JᵀJ has a row for
    each component of S/σ, and one for each strip, √F'' times the distance beyond its nearer edge.
    """
    own, noise = z[:-NUISANCES], _Noise.of(z)
    model = box.model(own)
    places = _likelier_places(model, spans, noise, points, places, steps)
    position, tangents = position_and_tangents(model, places[:, 0], places[:, 1])
    gap, strips = (position - points) / noise.sigma, _Strips.of(model, spans, noise.tau, places)
    here = potential(strips.x, strips.half, noise.rho)
    square = jnp.sum(gap**2, axis=-1)
    each = 0.5 * square + jnp.sum(here.value, axis=0)
    total = jnp.sum(weights)
    cost = jnp.sum(weights * each) + total * (jnp.log(noise.sigma) + jnp.log(spans.area))

    moved = by_coordinates(box, own, places) / noise.sigma
    u, v = strips.share + 0.5
    widened = jnp.stack([between(slopes.across, v)[0], between(slopes.along, u)[0]]) / noise.tau
    stretched = jnp.sum(here.slope * strips.x + here.by_width * strips.half, axis=0)
    firmer = jnp.sum(here.slope**2, axis=0) * noise.rho
    pull = here.slope * strips.share + 0.5 * here.by_width
    gradient = jnp.concatenate(
        [
            jnp.einsum("n,ni,inp->p", weights, gap, moved)
            + jnp.einsum("n,kn,knp->p", weights, pull, widened)
            + total * slopes.area / spans.area,
            jnp.stack(
                [
                    total - jnp.sum(weights * (square + stretched)),
                    -jnp.sum(weights * (stretched + firmer)),
                ]
            ),
        ]
    )

    root = jnp.sqrt(here.curvature)
    # The distance beyond the nearer edge is proportional to the width of the strip, and to 1/τ.
    beyond = strips.side * strips.x - strips.half
    edges = (strips.share - 0.5 * strips.side)[..., None] * widened
    blur = jnp.broadcast_to((-strips.side * beyond)[..., None], (*beyond.shape, NUISANCES))
    edges = jnp.concatenate([edges, blur], axis=-1) * root[..., None]
    none = jnp.zeros((*moved.shape[:2], NUISANCES))
    by_z = jnp.concatenate([jnp.concatenate([moved, none], axis=-1), edges])
    across = strips.beyond * root[..., None]
    by_p = jnp.concatenate([tangents.transpose(2, 1, 0) / noise.sigma, across])
    a_pp = jnp.einsum("kni,knj->nij", by_p, by_p)
    a_pz = jnp.einsum("kni,knq->niq", by_p, by_z)
    following = -_inverse(a_pp) @ a_pz
    weighted = by_z * jnp.sqrt(weights)[:, None]
    rows = weighted.reshape(-1, by_z.shape[-1])
    bound, answer = (x.reshape(-1, x.shape[-1]) for x in (a_pz, weights[:, None, None] * following))
    information = rows.T @ rows + bound.T @ answer
    # What the squares leave out: σ and τ change twice what they change.
    twice = jnp.sum(weights * jnp.sum(here.slope * strips.side * jnp.maximum(beyond, 0.0), axis=0))
    information = information.at[-2:, -2:].add(twice)
    information = information.at[-2, -2].add(2 * jnp.sum(weights * square))
    return SheetCost(cost, gradient, information, places, following, each)


_block_cost = Program(_cost)


def _likelier_places(
    model: AbstractSurface,
    spans: Spans,
    noise: _Noise,
    points: Float[Array, "n 3"],
    places: Float[Array, "n 2"],
    steps: int | Int[Array, ""],
) -> Float[Array, "n 2"]:
    """The places of least cost of all points, near given ones."""

    def expand(places: Array) -> tuple[Array, Array, Array]:
        """The cost of every point at its place, with the gradient and the Hessian by the place."""
        position, tangents = position_and_tangents(model, places[:, 0], places[:, 1])
        gap, tangents = (position - points) / noise.sigma, tangents / noise.sigma
        strips = _Strips.of(model, spans, noise.tau, places)
        here = potential(strips.x, strips.half, noise.rho)
        slope = here.slope[..., None] * strips.by_place
        slope = slope + here.by_width[..., None] * strips.widening
        # Near an edge F depends on the distance beyond it alone; and Gauss-Newton for the rest, because
        # the bending of the surface within the noise hardly counts.
        bend = jnp.einsum("kn,kni,knj->nij", here.curvature, strips.beyond, strips.beyond)
        return (
            0.5 * jnp.sum(gap**2, axis=-1) + jnp.sum(here.value, axis=0),
            jnp.einsum("kni,ni->nk", tangents, gap) + jnp.sum(slope, axis=0),
            jnp.einsum("kni,lni->nkl", tangents, tangents) + bend,
        )

    low, high = (jnp.asarray(side, float) for side in zip(*model.domain, strict=True))
    low, high = low - _BEYOND * (high - low), high + _BEYOND * (high - low)
    return least_places(expand, places, steps, low, high)[0]


def _inverse(matrix: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """Inverses of symmetric 2 × 2 matrices."""
    a, b, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]
    adjugate = jnp.stack([jnp.stack([d, -b], axis=-1), jnp.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b**2 + 1e-300)[:, None, None]
