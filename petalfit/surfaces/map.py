"""The differentiable map (u, v) → ℝ³, with tangents, normals and areas from its derivatives."""

from __future__ import annotations

import abc
from typing import ClassVar, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from petalfit.surfaces.traits import Oscillation

# The value of a parameter. Leaves are kept as given: a Python float keeps its 64 bits, whatever
# the precision that jax computes in.
Scalar: TypeAlias = float | int | np.floating | Real[Array, ""] | Real[np.ndarray, ""]


class Domain(NamedTuple):
    """The domain of a surface: the rectangle of its parameters u and v.

    Attributes:
        u: The least and the greatest u.
        v: The least and the greatest v.
    """

    u: tuple[float, float]
    v: tuple[float, float]

    @property
    def base(self) -> tuple[float, float]:
        """The place (u, v) of a petal's base: the middle of the side where v is least."""
        return 0.5 * sum(self.u), self.v[0]

    @property
    def tip(self) -> tuple[float, float]:
        """The place (u, v) of a petal's tip: the middle of the side where v is greatest."""
        return 0.5 * sum(self.u), self.v[1]


class AbstractMap(eqx.Module):
    """A map S(u, v) to ℝ³. A subclass defines `domain` and `position`; autodiff gives the rest.

    `position` is written with `jax.numpy`, elementwise in u and v, so that all methods work on arrays of
    any shape without `vmap`. The leaves of the module are the surface's parameters.

    Attributes:
        domain: The ranges of u and v.
        orientation: +1 if ∂S/∂u × ∂S/∂v is the outward normal (+z for the rectangle), −1 if the paper's
            parametrisation makes it point inward.
        regular: True promises that the tangents are independent everywhere. `normal` then skips the
            treatment of poles, which is half the cost of a deformed surface's derivatives.
        edges: Whether the surface has edges at the ends of u, and at the ends of v. Without an edge, the
            map continues beyond the end: it is periodic, or passes over a pole.
        oscillation: The two parameters of a pattern of many waves, if the surface has one.
    """

    domain: ClassVar[Domain]
    orientation: ClassVar[float] = 1.0
    regular: ClassVar[bool] = False
    edges: ClassVar[tuple[bool, bool]] = (True, True)
    oscillation: ClassVar[Oscillation | None] = None

    @property
    def shadow(self) -> AbstractMap | None:
        """The projection of this surface onto the plane z = 0, with the same (u, v), or None.

        First guesses of foot points are taken from it, because the nearest place of a surface with fine
        waves is often on the wrong wave. With None (the default) they are the nearest places of the
        surface itself.
        """
        return None

    @abc.abstractmethod
    def position(
        self, u: Float[Array, "*shape"], v: Float[Array, "*shape"]
    ) -> Float[Array, "*shape 3"]:
        """The points S(u, v), for u and v of the same shape."""

    def __call__(
        self, u: Real[ArrayLike, "..."], v: Real[ArrayLike, "..."]
    ) -> Float[Array, "... 3"]:
        """The points S(u, v).

        Args:
            u: Values of the first parameter, of any shape that broadcasts with `v`.
            v: Values of the second parameter.

        Returns:
            The points, in the unit of the surface's lengths; their shape is the broadcast shape followed
            by 3.
        """
        return self.position(*broadcast_floats(u, v))

    def tangents(
        self, u: Real[ArrayLike, "..."], v: Real[ArrayLike, "..."]
    ) -> tuple[Float[Array, "... 3"], Float[Array, "... 3"]]:
        """The partial derivatives ∂S/∂u and ∂S/∂v, each of shape (..., 3)."""
        tangent_u, tangent_v = position_and_tangents(self, *broadcast_floats(u, v))[1]
        return tangent_u, tangent_v

    def normal(self, u: Real[ArrayLike, "..."], v: Real[ArrayLike, "..."]) -> Float[Array, "... 3"]:
        """The unit normals, shape (..., 3), by automatic differentiation of the map.

        Where a tangent vanishes, as ∂S/∂v does at the poles of an ellipsoid, the normal is the limit
        from inside the domain; values and first derivatives stay finite there.
        """
        u, v = broadcast_floats(u, v)
        cross = _cross(self, u, v)
        if not self.regular:
            cross = self._away_from_poles(u, v, cross)
        squared = jnp.sum(cross**2, -1, keepdims=True)
        return self.orientation * cross / jnp.sqrt(jnp.where(squared > 0, squared, 1.0))

    def _away_from_poles(self, u: Array, v: Array, cross: Array) -> Array:
        """N = ∂S/∂u × ∂S/∂v, or, where that vanishes, a vector in the direction of its limit."""
        _, tangents = position_and_tangents(self, u, v)
        scale = jnp.sum(tangents**2, (0, -1))[..., None]
        squared = jnp.sum(cross**2, -1, keepdims=True)
        degenerate = squared <= (32 * jnp.finfo(cross.dtype).eps * scale) ** 2
        # At a pole N vanishes like h·N', with h the distance into the domain. Since N/h = N' + h·N''/2,
        # N' evaluated at half the offset has the right slope as well as the right value.
        (u_low, u_high), (v_low, v_high) = self.domain
        inward = jax.tree.map(
            jax.lax.stop_gradient, (0.5 * (u_low + u_high) - u, 0.5 * (v_low + v_high) - v)
        )
        half = tuple(0.5 * (x + jax.lax.stop_gradient(x)) for x in (u, v))
        _, derivative = jax.jvp(lambda u, v: _cross(self, u, v), half, inward)
        return jnp.where(degenerate, derivative, cross)

    def area_element(
        self, u: Real[ArrayLike, "..."], v: Real[ArrayLike, "..."]
    ) -> Float[Array, "..."]:
        """The area per unit of du dv, |∂S/∂u × ∂S/∂v|; at a pole it is zero, with a zero gradient."""
        squared = jnp.sum(_cross(self, *broadcast_floats(u, v)) ** 2, -1)
        positive = squared > 0
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)

    def area(self, resolution: tuple[int, int] = (512, 256)) -> Float[Array, ""]:
        """The surface area by the midpoint rule on `resolution` cells, in the unit of length squared."""
        (u_low, u_high), (v_low, v_high) = self.domain
        n_u, n_v = resolution
        u = u_low + (u_high - u_low) * (jnp.arange(n_u) + 0.5) / n_u
        v = v_low + (v_high - v_low) * (jnp.arange(n_v) + 0.5) / n_v
        cell = (u_high - u_low) * (v_high - v_low) / (n_u * n_v)
        return cell * jnp.sum(self.area_element(u[:, None], v[None, :]))


def broadcast_floats(u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Converts u and v to floating point arrays of the same shape."""
    dtype = jnp.result_type(u, v, float)
    u, v = jnp.broadcast_arrays(jnp.asarray(u, dtype), jnp.asarray(v, dtype))
    return u, v


def position_and_tangents(
    surface: AbstractMap, u: Float[Array, "*shape"], v: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape 3"], Float[Array, "2 *shape 3"]]:
    """S, and the tangents ∂S/∂u and ∂S/∂v along a new first axis, by one pass through the map."""

    def along(du: ArrayLike, dv: ArrayLike) -> tuple[Array, Array]:
        return jax.jvp(surface.position, (u, v), (jnp.full_like(u, du), jnp.full_like(v, dv)))

    return jax.vmap(along, out_axes=(None, 0))(*np.eye(2))


def _cross(surface: AbstractMap, u: Array, v: Array) -> Array:
    # Written out, because `jnp.cross` costs twice as much under vmap and grad.
    _, tangents = position_and_tangents(surface, u, v)
    (a_x, a_y, a_z), (b_x, b_y, b_z) = (jnp.unstack(tangent, axis=-1) for tangent in tangents)
    return jnp.stack([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x], axis=-1)
