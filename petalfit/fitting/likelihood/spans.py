"""The size of a surface between its edges, as the likelihood of a sheet needs it, with derivatives."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.fitting.coordinates import Box
from petalfit.surfaces import AbstractSurface

_ACROSS, _ALONG = 13, 33  # nodes in u and v


class Spans(NamedTuple):
    """The size of a surface between its edges, or its derivatives by p coordinates on one more axis.

    Attributes:
        across: The width between the u edges at nodes of v, at right angles to them, shape (_ALONG,).
        along: The width between the v edges at nodes of u, shape (_ACROSS,).
        area: The area.
    """

    across: Float[Array, "n_v *p"]
    along: Float[Array, "n_u *p"]
    area: Float[Array, "*p"]


_INDEX = np.arange(_ACROSS * _ALONG).reshape(_ACROSS, _ALONG)
_BORDER = np.concatenate([_INDEX[0], _INDEX[-1], _INDEX[:, 0], _INDEX[:, -1]])


def _spans_of(
    box: Box, own: Float[Array, " p"]
) -> tuple[Spans, Spans, Float[Array, "k 3"], Float[Array, "3 k p"]]:
    """The spans of a surface and places on its outline, each with derivatives by the coordinates.

    Tangents are those of the polynomials through positions at the nodes, so that both follow from the
    positions and their derivatives alone. Areas are right to some 1e-4, widths to 1e-3 except at the very
    ends, where no points are.
    """
    model = box.model(own)
    (u, u_weights), (v, v_weights) = nodes_of(_ACROSS), nodes_of(_ALONG)
    (u_low, u_high), (v_low, v_high) = model.domain
    grid = np.meshgrid(u_low + (u_high - u_low) * u, v_low + (v_high - v_low) * v, indexing="ij")
    nodes = jnp.asarray(np.stack([side.ravel() for side in grid], axis=-1))
    place = model.position(nodes[:, 0], nodes[:, 1]).reshape(_ACROSS, _ALONG, 3)
    moved = by_coordinates(box, own, nodes).reshape(3, _ACROSS, _ALONG, -1)
    by_u, by_v = _differences(u), _differences(v)
    a, b = jnp.einsum("ab,bvc->avc", by_u, place), jnp.einsum("ab,ubc->uac", by_v, place)
    moved_a = jnp.einsum("ab,cbvp->avpc", by_u, moved)
    moved_b = jnp.einsum("ab,cubp->uapc", by_v, moved)
    cross, long_a, long_b = jnp.cross(a, b), _norm(a), _norm(b)
    element = _norm(cross)
    normal = cross / element[..., None]
    across, along = element / long_b, element / long_a
    # Derivatives of the element of area, by the rule for (a × b)·n, and of the lengths of the tangents.
    grown = jnp.einsum("uvpc,uvc->uvp", moved_a, jnp.cross(b, normal))
    grown = grown + jnp.einsum("uvpc,uvc->uvp", moved_b, jnp.cross(normal, a))
    longer_a = jnp.einsum("uvpc,uvc->uvp", moved_a, a / long_a[..., None])
    longer_b = jnp.einsum("uvpc,uvc->uvp", moved_b, b / long_b[..., None])
    wider = (grown - across[..., None] * longer_b) / long_b[..., None]
    higher = (grown - along[..., None] * longer_a) / long_a[..., None]
    return (
        Spans(
            jnp.asarray(u_weights @ across),
            jnp.asarray(along @ v_weights),
            jnp.asarray(u_weights @ element @ v_weights),
        ),
        Spans(
            jnp.einsum("u,uvp->vp", u_weights, wider),
            jnp.einsum("v,uvp->up", v_weights, higher),
            jnp.einsum("u,v,uvp->p", u_weights, v_weights, grown),
        ),
        place.reshape(-1, 3)[_BORDER],
        moved.reshape(3, len(nodes), -1)[:, _BORDER],
    )


spans_of = Program(_spans_of)


def border_weights() -> Float[np.ndarray, " k"]:
    """The shares of the places on the outline in their sides."""
    (_, across), (_, along) = nodes_of(_ACROSS), nodes_of(_ALONG)
    return np.concatenate([along, along, across, across])


def nodes_of(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes from 0 to 1, denser towards the ends, and the weights of integrals from 0 to 1."""
    turn = np.pi * np.arange(number) / (number - 1)
    # Clenshaw and Curtis: integrals of Chebyshev polynomials, which values at the nodes determine.
    order = np.arange(number)
    integrals = np.where(order % 2 == 0, 1.0 / (1.0 - order**2 + (order % 2)), 0.0)
    half = np.where((order == 0) | (order == number - 1), 0.5, 1.0)
    weights = 2 / (number - 1) * half * (np.cos(np.outer(turn, order)) @ (half * integrals))
    return 0.5 - 0.5 * np.cos(turn), weights


def _differences(nodes: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m m"]:
    """The matrix that differentiates the polynomial through values at Chebyshev nodes."""
    weights = (-1.0) ** np.arange(len(nodes))
    weights[[0, -1]] *= 0.5
    apart = nodes[:, None] - nodes + np.eye(len(nodes))
    matrix = weights / weights[:, None] / apart
    np.fill_diagonal(matrix, 0.0)
    return matrix - np.diag(matrix.sum(axis=1))


def between(
    values: Float[Array, "m *p"], place: Float[Array, " n"]
) -> tuple[Float[Array, "n *p"], Float[Array, "n *p"]]:
    """Cubic interpolation between values at `nodes_of`, and its derivative; constant beyond the ends."""
    number = len(values)
    inside = jnp.clip(place, 1e-9, 1.0 - 1e-9)
    # In the angle of the nodes they are evenly spaced, and a smooth function is even at both ends.
    t = jnp.arccos(1.0 - 2.0 * inside) * ((number - 1) / np.pi)
    k = jnp.clip(jnp.floor(t).astype(int), 0, number - 2)
    shape = (-1,) + (1,) * (values.ndim - 1)
    r = (t - k).reshape(shape)
    before, after = values[jnp.abs(k - 1)], values[number - 1 - jnp.abs(number - 1 - (k + 2))]
    here, there = values[k], values[k + 1]
    slope, next_slope = 0.5 * (there - before), 0.5 * (after - here)
    change = there - here
    square, cube = 3 * change - 2 * slope - next_slope, slope + next_slope - 2 * change
    value = here + r * (slope + r * (square + r * cube))
    turning = jnp.where(inside == place, (number - 1) / np.pi / jnp.sqrt(inside * (1 - inside)), 0)
    return value, (slope + r * (2 * square + 3 * r * cube)) * turning.reshape(shape)


def _norm(vectors: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    return jnp.sqrt(jnp.sum(vectors**2, axis=-1) + 1e-300)


def by_coordinates(
    box: Box, own: Float[Array, " p"], places: Float[Array, "n 2"]
) -> Float[Array, "3 n p"]:
    """Derivatives of the positions of places by the coordinates of the free parameters."""
    model = box.model(own)

    def component(axis: Array) -> Array:
        def along(model: AbstractSurface, place: Array) -> Array:
            return jnp.sum(axis * model.position(place[0], place[1]))

        return box.gather(jax.vmap(jax.grad(along), (None, 0))(model, places))

    return jax.vmap(component)(jnp.eye(3)) * box.slopes(own)
