"""Deformed surfaces: a base shape, an offset of its points, and a height along its normal."""

from __future__ import annotations

import abc

import jax.numpy as jnp
from jaxtyping import Array

from petalfit.surfaces.surface import AbstractSurface


class AbstractDeformedSurface(AbstractSurface):
    """The paper's additive deformation: S = P + n Δg(u, v, P) with P = base(u, v) + offset(u, v).

    n is the unit normal of the *undeformed* base, by automatic differentiation. `height` receives P, the
    point after the offset and before the height, because Δg of Eq. 8 depends on x and y of that point.
    """

    @property
    @abc.abstractmethod
    def base(self) -> AbstractSurface:
        """The undeformed shape."""

    def offset(self, u: Array, v: Array) -> Array:
        """The displacement of the base's points, shape (..., 3); for a petal (Δx, Δy, 0)."""
        return jnp.zeros((*u.shape, 3), u.dtype)

    def height(self, u: Array, v: Array, point: Array) -> Array:
        """The displacement Δg along the base's unit normal, shape (...)."""
        return jnp.zeros_like(u)

    def position(self, u: Array, v: Array) -> Array:
        base = self.base
        point = base.position(u, v) + self.offset(u, v)
        if type(self).height is AbstractDeformedSurface.height:
            return point  # without heights the normal, most of the work, is not needed
        return point + base.normal(u, v) * self.height(u, v, point)[..., None]
