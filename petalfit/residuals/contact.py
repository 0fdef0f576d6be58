"""The frame of a surface at a foot point, and derivatives pulled back to the surface's parameters."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.surfaces import AbstractSurface, position_and_tangents

Numbers: TypeAlias = Array | np.ndarray


class Frame(NamedTuple):
    """The frames of a surface at given (u, v): positions, unit normals, and the nearer edges.

    Inside compiled programs these are arrays of jax, outside of them arrays of NumPy.

    Attributes:
        position: The points S, shape (n, 3).
        normal: Unit normals, shape (n, 3); zero where the tangents are dependent.
        conormals: Unit vectors in the tangent plane, perpendicular to the nearer u edge and the nearer
            v edge, pointing out of the surface, shape (n, 2, 3).
        left: The distances to these edges along the surface, to first order, shape (n, 2); a very large
            number where the surface has no such edge.
        speed: |∂S/∂u| and |∂S/∂v|, shape (n, 2).
        area_element: |∂S/∂u × ∂S/∂v|, shape (n,).
    """

    position: Float[Any, "n 3"]
    normal: Float[Any, "n 3"]
    conormals: Float[Any, "n 2 3"]
    left: Float[Any, "n 2"]
    speed: Float[Any, "n 2"]
    area_element: Float[Any, " n"]

    def distance(self, points: Float[Any, "n 3"]) -> Float[Any, " n"]:
        """The signed distance of every point from the tangent plane, positive on the normal's side."""
        return _dot(self.normal, points - self.position)

    def beyond(self, points: Float[Any, "n 3"]) -> Float[Any, "n 2"]:
        """The distances of every point beyond the nearer u edge and v edge, negative inside."""
        return _dot(self.conormals, (points - self.position)[:, None]) - self.left


_NO_EDGE = 1e30  # the distance to an edge that does not exist


def frame(surface: AbstractSurface, uv: Float[Array, "n 2"]) -> Frame:
    """The frames of a surface at foot points `uv` (see `residuals.refine`)."""
    position, tangents = position_and_tangents(surface, uv[:, 0], uv[:, 1])
    side = jnp.moveaxis(tangents, 0, 1)
    along = side[:, ::-1]
    cross = surface.orientation * jnp.cross(side[:, 0], side[:, 1])
    element = jnp.sqrt(_dot(cross, cross))
    across = side - along * _ratio(_dot(side, along), _dot(along, along))[..., None]
    height = jnp.sqrt(_dot(across, across))
    low, high = (jnp.asarray(ends, uv.dtype) for ends in zip(*surface.domain, strict=True))
    outward = jnp.where(uv > 0.5 * (low + high), 1.0, -1.0)
    return Frame(
        position,
        cross * _ratio(1.0, element)[:, None],
        across * (outward * _ratio(1.0, height))[..., None],
        jnp.where(jnp.asarray(surface.edges), jnp.minimum(high - uv, uv - low) * height, _NO_EDGE),
        jnp.sqrt(_dot(side, side)),
        element,
    )


def pull_back(
    surface: AbstractSurface, uv: Float[Array, "n 2"], covectors: Float[Array, "n 3"]
) -> AbstractSurface:
    """The derivatives of w·S(u, v) by the surface's parameters, for every point.

    One reverse pass per point gives all parameters at once. This is four to seven times faster than
    forward derivatives by one parameter after the other.

    Returns:
        A pytree like `surface`; the leaf of a scalar parameter has shape (n,).
    """

    def projected(surface: AbstractSurface, uv: Array, w: Array) -> Array:
        return jnp.sum(w * surface.position(uv[0], uv[1]))

    return jax.vmap(jax.grad(projected), (None, 0, 0))(surface, uv, covectors)


def _dot(a: Any, b: Any) -> Any:
    return (a * b).sum(axis=-1)  # an array of jax, or of NumPy


def _ratio(a: Array | float, b: Array) -> Array:
    """The ratio a/b, or zero where b vanishes (a degenerate tangent)."""
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1.0), 0.0)
