"""Residuals of clouds: normal distances at foot points, and distances beyond the edges."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petalfit.residuals.contact import Frame, frame
from petalfit.residuals.edge import (
    EDGE_NODES,
    edge_nodes,
    edge_pull,
    edge_residual,
    edge_score,
)
from petalfit.residuals.foot_point import slide_foot_points
from petalfit.residuals.term import AbstractFrozen, AbstractTerm, Pull
from petalfit.surfaces import AbstractSurface

# Edge residuals are computed for the quarter of the points nearest to an edge, but for at least so many,
# unless they are wanted everywhere.
_FEW = 256


class Data(NamedTuple):
    """A cloud in the form that compiled programs use, padded to a fixed size with zero weights.

    Attributes:
        points: The points in the model's frame, shape (n, 3).
        weights: The number of observations that each point counts for, shape (n,); zero for padding.
        sigma: The standard deviation of the noise, in the unit of length; NaN to estimate it.
    """

    points: Float[Array, "n 3"]
    weights: Float[Array, " n"]
    sigma: Float[Array, ""]


def estimate_sigma(data: Data, distance: Float[Array, " n"], free: int) -> Float[Array, ""]:
    """The given noise, or the estimate √(Σ w d² / (Σ w − p)), at least 1e-9 of the extent.

    p is `free`, the number of fitted parameters.
    """
    count = jnp.sum(data.weights)
    variance = jnp.sum(data.weights * distance**2) / jnp.maximum(count - free, 1)
    extent = jnp.max(jnp.abs(data.points))
    estimated = jnp.maximum(jnp.sqrt(variance), 1e-9 * extent)
    return jnp.where(jnp.isnan(data.sigma), estimated, data.sigma)


class TangentDistance(AbstractTerm):
    """The cost of a cloud, Σ d²/2σ² − Σ log Φ(−e/σ) + Σ log Area.

    d are normal distances, e the distances beyond the edges (see `petalfit.residuals.edge`). To first
    order d does not change when its foot point slides, so nothing is lost by holding foot points fixed.

    Attributes:
        data: The cloud.
        uv: The foot points, shape (n, 2).
        sigma: The noise, given or estimated from the distances.
        slides: The number of Newton steps of the foot points before they are held fixed; 0 if they have
            converged already.
        everywhere: Whether edge residuals are computed for all points, and not only for those nearest to
            an edge.
    """

    data: Data
    uv: Float[Array, "n 2"]
    sigma: Float[Array, ""]
    slides: Int[Array | np.ndarray, ""] = eqx.field(default_factory=lambda: np.asarray(2))
    everywhere: bool = eqx.field(static=True, default=False)

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[TangentDistance, FrozenDistance, Pull]:
        slides = jnp.asarray(self.slides)
        data, uv = self.data, slide_foot_points(surface, self.data.points, self.uv, slides)
        nodes = jnp.asarray(edge_nodes(surface.domain), uv.dtype)
        both = frame(surface, jnp.concatenate([uv, nodes]))
        here, edge = (Frame(*(x[s] for x in both)) for s in (np.s_[: len(uv)], np.s_[len(uv) :]))
        sigma = estimate_sigma(data, here.distance(data.points), free)
        beyond = jnp.max(here.beyond(data.points), axis=-1)
        beyond = jnp.where(data.weights > 0, beyond, -jnp.inf)
        few = len(uv) if self.everywhere else max(len(uv) // 4, min(len(uv), _FEW))
        _, near = jax.lax.top_k(beyond, few)
        pull = edge_pull(surface, edge, uv, data.weights, beyond / sigma, sigma)
        return (
            TangentDistance(data=data, uv=uv, sigma=sigma, everywhere=self.everywhere),
            FrozenDistance(data, uv, sigma, here, near),
            Pull(nodes[:EDGE_NODES], pull),
        )


class FrozenDistance(AbstractFrozen):
    """`TangentDistance` with fixed foot points: distances to the frames at the foot points.

    Attributes:
        data: The cloud.
        uv: The foot points, shape (n, 2).
        sigma: The noise.
        frame: The frames of the surface at the foot points.
        near: The indices of the points that may lie near an edge, shape (m,).
    """

    data: Data
    uv: Float[Array, "n 2"]
    sigma: Float[Array, ""]
    frame: Frame
    near: Int[Array, " m"]

    def residual(self, surface: AbstractSurface) -> Float[Array, " n_and_m"]:
        distance, beyond = self._decompose(surface)
        edge = jnp.linalg.norm(edge_residual(beyond), axis=-1)
        root = jnp.sqrt(self.data.weights)
        return jnp.concatenate([root * distance, root[self.near] * edge])

    def slopes(
        self, surface: AbstractSurface
    ) -> tuple[Float[Array, "n_and_m 2"], Float[Array, "n_and_m 3"]]:
        _, beyond = self._decompose(surface)
        residual, score = edge_residual(beyond), edge_score(beyond)
        norm = jnp.linalg.norm(residual, axis=-1, keepdims=True)
        slope = jnp.where(norm > 0, score / jnp.where(norm > 0, norm, 1.0), 0.0)
        edge = jnp.sum(slope[..., None] * self.frame.conormals[self.near], axis=1)
        rows = jnp.concatenate([jnp.arange(len(self.uv)), self.near])
        root = jnp.sqrt(self.data.weights[rows]) / self.sigma
        return self.uv[rows], -jnp.concatenate([self.frame.normal, edge]) * root[:, None]

    def _decompose(self, surface: AbstractSurface) -> tuple[Array, Array]:
        """The normal distances, and the edge distances of the points near an edge, in units of σ."""
        offset = self.data.points - surface.position(self.uv[:, 0], self.uv[:, 1])
        distance = jnp.sum(self.frame.normal * offset, axis=-1)
        conormals, left = self.frame.conormals[self.near], self.frame.left[self.near]
        beyond = jnp.sum(conormals * offset[self.near, None, :], axis=-1) - left
        return distance / self.sigma, beyond / self.sigma
