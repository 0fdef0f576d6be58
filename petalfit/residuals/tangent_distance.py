"""Residuals of clouds: normal distances at foot points, and distances beyond the edges."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from petalfit.residuals.contact import Frame
from petalfit.residuals.edge import (
    EDGE_NODES,
    edge_nodes,
    edge_pull,
    edge_residual,
    edge_score,
)
from petalfit.residuals.programs import frames, slide_foot_points
from petalfit.residuals.term import AbstractFrozen, AbstractTerm, Pull
from petalfit.surfaces import AbstractSurface

# Edge residuals are computed for the quarter of the points nearest to an edge, but for at least so many,
# unless they are wanted everywhere.
_FEW = 256
_SLIDES = 2  # Newton steps of the foot points in each round


class Data(NamedTuple):
    """A cloud, as residuals use it: arrays of NumPy, or of jax where a fit is differentiated.

    Attributes:
        points: The points in the model's frame, shape (n, 3).
        weights: The number of observations that each point counts for, shape (n,).
        sigma: The standard deviation of the noise, in the unit of length; NaN to estimate it.
    """

    points: Float[Any, "n 3"]
    weights: Float[Any, " n"]
    sigma: float | Float[Any, ""]

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "n 3"],
        weights: Float[np.ndarray, " n"],
        noise: float | None,
    ) -> Data:
        """A cloud with a given noise, or None to estimate it."""
        return cls(points, weights, np.nan if noise is None else float(noise))


def estimated_noise(data: Data, distance: Float[np.ndarray, " n"], free: int) -> float:
    """The given noise, or the estimate √(Σ w d² / (Σ w − p)), at least 1e-9 of the extent.

    p is `free`, the number of fitted parameters.
    """
    if not np.isnan(data.sigma):
        return float(data.sigma)
    count = np.sum(data.weights)
    variance = np.sum(data.weights * distance**2) / max(count - free, 1)
    return float(max(np.sqrt(variance), 1e-9 * np.max(np.abs(data.points))))


@dataclasses.dataclass(frozen=True, eq=False)
class TangentDistance(AbstractTerm):
    """The cost of a cloud, Σ d²/2σ² − Σ log Φ(−e/σ) + Σ log Area.

    d are normal distances, e the distances beyond the edges (see `petalfit.residuals.edge`). To first
    order d does not change when its foot point slides, so nothing is lost by holding foot points fixed.

    Attributes:
        data: The cloud.
        uv: The foot points, shape (n, 2).
        sigma: The noise, given or estimated from the distances.
        everywhere: Whether edge residuals are computed for all points, and not only for those nearest to
            an edge.
    """

    data: Data
    uv: Float[np.ndarray, "n 2"]
    sigma: float
    everywhere: bool = False

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[TangentDistance, FrozenDistance, Pull]:
        data = self.data
        uv, _, _ = slide_foot_points(surface, data.points, self.uv, _SLIDES)
        nodes = edge_nodes(surface.domain)
        both = frames(surface, np.concatenate([uv, nodes]))
        here, edge = (Frame(*(x[s] for x in both)) for s in (np.s_[: len(uv)], np.s_[len(uv) :]))
        sigma = estimated_noise(data, here.distance(data.points), free)
        beyond = np.max(here.beyond(data.points), axis=-1)
        beyond = np.where(data.weights > 0, beyond, -np.inf)
        few = len(uv) if self.everywhere else max(len(uv) // 4, min(len(uv), _FEW))
        near = np.argpartition(-beyond, few - 1)[:few]
        pull = edge_pull(surface, edge, uv, data.weights, beyond / sigma, sigma)
        return (
            TangentDistance(data=data, uv=uv, sigma=sigma, everywhere=self.everywhere),
            FrozenDistance(data=data, uv=uv, sigma=sigma, frame=here, near=near),
            Pull(nodes[:EDGE_NODES], np.asarray(pull), edge.position[:EDGE_NODES]),
        )


@dataclasses.dataclass(frozen=True, eq=False)
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
    uv: Float[np.ndarray, "n 2"]
    sigma: float
    frame: Frame
    near: Int[np.ndarray, " m"]

    def residual(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n_and_m"]:
        distance, beyond = self._decompose(position)
        edge = np.linalg.norm(edge_residual(beyond), axis=-1)
        root = np.sqrt(self.data.weights)
        return np.concatenate([root * distance, root[self.near] * edge])

    def slopes(
        self, position: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n_and_m"], Float[np.ndarray, "n_and_m 3"]]:
        _, beyond = self._decompose(position)
        residual, score = edge_residual(beyond), edge_score(beyond)
        norm = np.linalg.norm(residual, axis=-1, keepdims=True)
        slope = np.where(norm > 0, score / np.where(norm > 0, norm, 1.0), 0.0)
        edge = np.sum(slope[..., None] * self.frame.conormals[self.near], axis=1)
        rows = np.concatenate([np.arange(len(self.uv)), self.near])
        root = np.sqrt(self.data.weights[rows]) / self.sigma
        return rows, -np.concatenate([self.frame.normal, edge]) * root[:, None]

    def _decompose(
        self, position: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "m 2"]]:
        """The normal distances, and the edge distances of the points near an edge, in units of σ."""
        offset = self.data.points - position
        distance = np.sum(self.frame.normal * offset, axis=-1)
        conormals, left = self.frame.conormals[self.near], self.frame.left[self.near]
        beyond = np.sum(conormals * offset[self.near, None, :], axis=-1) - left
        return distance / self.sigma, beyond / self.sigma
