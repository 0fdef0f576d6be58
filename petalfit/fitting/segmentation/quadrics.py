"""Curved pieces of sheets around all points, and how far each neighbour lies from them."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from petalfit.fitting.segmentation.neighbours import Neighbours

_ROUNDS = 4
_ALIKE = 0.35  # as for planes
_CURVED = 0.1  # tolerated height at the rim of a neighbourhood, in radii; smaller in later rounds
_FLAT = 0.005  # weight of flatness, in neighbours
_COEFFICIENTS = 6
# The part of the points that is surely in flat places, and its quantile of the spread of Gaussian noise
# about quadrics, in standard deviations.
_FLAT_PLACES, _QUANTILE = 0.2, 0.87


@dataclasses.dataclass(frozen=True)
class Quadrics:
    """The quadric z = c₀ + c₁x + c₂y + ½c₃x² + c₄xy + ½c₅y² near every point, in its own frame.

    Attributes:
        axes: The axes of the frames as rows, the last along the normal, shape (n, 3, 3).
        unit: The unit of the frames, shape (n,).
        coefficients: Shape (n, 6).
        normals: Unit normals of the quadrics at the points, shape (n, 3).
        residuals: Heights of the neighbours above the quadric of the point, shape (n, k).
        members: How much each neighbour took part in the fit, from 0 to 1, shape (n, k).
    """

    axes: Float[np.ndarray, "n 3 3"]
    unit: Float[np.ndarray, " n"]
    coefficients: Float[np.ndarray, "n 6"]
    normals: Float[np.ndarray, "n 3"]
    residuals: Float[np.ndarray, "n k"]
    members: Float[np.ndarray, "n k"]

    @classmethod
    def of(cls, near: Neighbours, normals: Float[np.ndarray, "n 3"], noise: float) -> Quadrics:
        """The quadrics of the sheets with given normals.

        Args:
            near: The neighbours of all points.
            normals: Unit normals of the sheets at all points, each of either sign.
            noise: Standard deviation of the points' distances from their sheets.
        """
        axes, unit = _frames(normals), near.radius[:, 0]
        local = np.einsum("nki,nji->nkj", near.offset, axes) / unit[:, None, None]
        local = np.concatenate(
            [local, np.zeros((len(local), 1, 3))], axis=1
        )  # and the point itself
        height, terms = local[..., 2], _terms(local[..., 0], local[..., 1])
        fraction = near.distance / near.radius
        alike = np.exp(
            -0.5 * (1 - np.einsum("nki,ni->nk", normals[near.others], normals) ** 2) / _ALIKE**2
        )
        off, coefficients, weights = height, np.zeros((len(local), 6)), np.ones(height.shape)
        for round_ in range(_ROUNDS):
            allowed = _CURVED * (1.0, 0.7, 0.5, 0.5)[round_]
            tolerance = 2 * noise / unit[:, None] + allowed * fraction**2
            members = np.exp(-0.5 * (off[:, :-1] / tolerance) ** 2)
            members = members * alike ** (1.0 if round_ == 0 else 0.3)
            weights = np.concatenate([members, np.ones((len(local), 1))], axis=1)
            flat = _FLAT * np.diag([0.0, 0, 0, 1, 1, 1]) * weights.sum(axis=1)[:, None, None]
            square = np.einsum("nk,nki,nkj->nij", weights, terms, terms) + flat
            right = np.einsum("nk,nki,nk->ni", weights, terms, height)
            coefficients = np.linalg.solve(square, right[..., None])[..., 0]
            off = height - np.einsum("nki,ni->nk", terms, coefficients)
        slope = np.einsum("ni,nij->nj", coefficients[:, 1:3], axes[:, :2])
        tilted = normals - slope
        tilted = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
        return cls(axes, unit, coefficients, tilted, off[:, :-1] * unit[:, None], weights[:, :-1])

    def above(self, near: Neighbours) -> Float[np.ndarray, "n k"]:
        """The height of every point above the quadrics of its neighbours."""
        index = near.others
        x, y, z = np.moveaxis(-np.einsum("nki,nkji->nkj", near.offset, self.axes[index]), -1, 0)
        unit = self.unit[index]
        terms = _terms(x / unit, y / unit)
        return z - unit * np.einsum("nki,nki->nk", terms, self.coefficients[index])

    def noise(self) -> float:
        """Standard deviation of the distances of points from their sheets.

        Where sheets touch or bend strongly the residuals are too large; the noise is that of flat places.
        """
        weight = np.maximum(self.members.sum(axis=1) - _COEFFICIENTS, 1.0)
        spread = np.sqrt(np.sum(self.members * self.residuals**2, axis=1) / weight)
        return float(np.quantile(spread, _FLAT_PLACES)) / _QUANTILE


def _frames(normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Right-handed frames whose last axes are the normals, their axes as rows."""
    aside = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normals, aside)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first), normals], axis=1)


def _terms(x: Float[np.ndarray, "n k"], y: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k 6"]:
    return np.stack([np.ones_like(x), x, y, 0.5 * x * x, x * y, 0.5 * y * y], axis=-1)
