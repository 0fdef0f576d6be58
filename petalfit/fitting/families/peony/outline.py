"""Starts of peony petals in a known pose: first the outline, then the heights.

The outline is a function of a_x, b_y and c alone, and the height above the plane is linear in the
amplitudes once (u, v) are known.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from petalfit.compilation import Program
from petalfit.components import PeonyPetal, parameters
from petalfit.fitting.coordinates import Coordinates, evenly_spread, with_values
from petalfit.fitting.likelihood.foot_points import straight_below
from petalfit.fitting.likelihood.linearise import tangents_at
from petalfit.residuals import Data

OUTLINE = ("a_x", "b_y", "c")
HEIGHTS = ("c_z", "dx", "dy", "midrib_height", "tip_curl")

# Directions of half a circle. Petals are symmetric about x = 0, so that support functions in the other
# half are the same.
_DIRECTIONS = np.pi * (np.arange(17) / 16 - 0.5)
_SHARES = np.array([1, *15 * [2], 1]) / 32
_BATCH = 256
_GENERATIONS = (4, 1, 1, 1, 1)  # batches of candidates in each generation
# The mean score of a direction is at most 0.4 for whole petals, and at least 1.7 for petals without tip.
_COMPLETE = 1.0

_TYPICAL = {name: parameters(PeonyPetal)[name].typical for name in OUTLINE}
_LOW, _HIGH = np.array(list(_TYPICAL.values())).T
_BOUNDS = np.array([parameters(PeonyPetal)[name].bounds for name in OUTLINE]).T
_EDGE = np.linspace(-0.5, 0.5, 25)
_OUTLINE_UV = np.concatenate(
    [
        np.stack([_EDGE, np.zeros(25)], -1),
        np.stack([_EDGE, np.ones(25)], -1),
        np.stack([np.full(25, 0.5), _EDGE + 0.5], -1),
    ]
)


def _positions(petals: PeonyPetal, uv: Float[Array, "n 2"]) -> Float[Array, "k n 3"]:
    """Positions on a batch of petals, whose leaves have shape (k,)."""
    return jax.vmap(lambda petal: petal.position(uv[:, 0], uv[:, 1]))(petals)


_outline_places = Program(_positions)


class OutlineSearch(NamedTuple):
    """Candidates for a_x, b_y and c. Those of the three that are not free keep the petal's values.

    Attributes:
        plane: The petal without heights, in its plane.
        given: The petal's a_x, b_y and c, shape (3,).
        moves: Whether each of these is free, shape (3,).
    """

    plane: PeonyPetal
    given: Float[np.ndarray, "3"]
    moves: Bool[np.ndarray, "3"]

    @classmethod
    def of(cls, petal: PeonyPetal, free: Collection[str]) -> OutlineSearch:
        """The search among outlines of a petal."""
        given = np.array([float(getattr(petal, name)) for name in OUTLINE])
        return cls(petal.shadow, given, np.isin(OUTLINE, [*free]))

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """The middle of the typical ranges."""
        return np.where(self.moves, 0.5 * (_LOW + _HIGH), self.given)

    def around(
        self, values: Float[np.ndarray, "3"], part: float, batches: int, others: int = 0
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k others"]]:
        """Candidates evenly spread around values, over a part of the typical ranges.

        With each come `others` further numbers, evenly spread in (0, 1).
        """
        evenly = evenly_spread(batches * _BATCH, 3 + others)
        spread = self.moves * (_HIGH - _LOW) * part
        return np.clip(values + spread * (evenly[:, :3] - 0.5), *_BOUNDS), evenly[:, 3:]

    def edges(self, values: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k m 2"]:
        """Places along the outlines."""
        outlines = [
            _repeated(self.plane, dict(zip(OUTLINE, batch.T, strict=True)))
            for batch in np.split(values, len(values) // _BATCH)
        ]
        places = [np.asarray(_outline_places(batch, _OUTLINE_UV)) for batch in outlines]
        return np.concatenate(places)[..., :2]


def fit_outline(
    petal: PeonyPetal,
    free: Collection[str],
    points: Float[np.ndarray, "n 3"],
) -> tuple[PeonyPetal, bool]:
    """Fits a_x, b_y and c, so that the outline has the support function of the points' x and y.

    Petals are symmetric about x = 0 (but for their scallops), so points are reflected there: half a
    petal shows the whole outline. A heavy-tailed score allows for missing parts. Candidates are first
    spread evenly over the typical ranges, then in generations around the best.

    Returns:
        The petal with the fitted outline, and whether the points have it. If not, a part of the petal is
        missing that matters for the outline.
    """
    directions = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])

    def along(xy: np.ndarray) -> np.ndarray:
        return np.stack([np.abs(xy[..., 0]), xy[..., 1]], axis=-1) @ directions

    # The farthest few of the points may be outliers.
    target = np.sort(along(points), axis=0)[-(1 + len(points) // 128)]
    tolerance = 0.01 * np.max(np.abs(target))
    search, score = OutlineSearch.of(petal, free), np.inf
    best = search.middle
    for k, batches in enumerate(_GENERATIONS):
        candidates, _ = search.around(best, 0.3**k, batches)
        gap = (np.max(along(search.edges(candidates)), axis=1) - target) / tolerance
        scores = np.log1p(gap**2) @ _SHARES
        best, score = candidates[np.argmin(scores)], np.min(scores)
    return with_values(petal, dict(zip(OUTLINE, best, strict=True))), bool(score < _COMPLETE)


def _repeated(petal: PeonyPetal, values: dict[str, np.ndarray]) -> PeonyPetal:
    """A batch of petals that differ in the given values."""
    same = {name: np.full(_BATCH, float(value)) for name, value in vars(petal).items()}
    return with_values(petal, same | values)


class Heights(NamedTuple):
    """Heights of points above a petal's plane, and the heights that amplitudes give the petal there.

    Attributes:
        names: Names of the free amplitudes.
        basis: Heights of the petal below every point for amplitudes of 1, shape (n, k).
        above: Heights of the points above the petal without these amplitudes, shape (n,).
        uv: Places straight below the points, shape (n, 2).
    """

    names: tuple[str, ...]
    basis: Float[np.ndarray, "n k"]
    above: Float[np.ndarray, " n"]
    uv: Float[np.ndarray, "n 2"]

    @classmethod
    def of(cls, petal: PeonyPetal, free: Collection[str], data: Data) -> Heights:
        """The heights of points above a petal's plane; its own values of free amplitudes do not count."""
        names = tuple(name for name in HEIGHTS if name in free)
        plane = with_values(petal, dict.fromkeys((*names, "rib_amplitude"), 0.0))
        uv = straight_below(plane.shadow, data.points)
        here = Coordinates.of(plane, names)
        t = here.inverse(plane)
        seen, slopes = tangents_at(here, t, uv)
        # A point straight above its foot point has the distance n_z (z - S_z); S_z is linear in the
        # amplitudes.
        n_z = seen.normal[:, 2]
        n_z = np.where(np.abs(n_z) > 1e-3, n_z, np.inf)
        basis = -slopes / here.slopes(t) / n_z[:, None]
        return cls(names, basis, seen.distance(data.points) / n_z, uv)


def fit_amplitudes(
    heights: Float[np.ndarray, " n"],
    basis: Float[np.ndarray, "n k"],
    weights: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " k"]:
    """The amplitudes that explain heights best, by robust linear least squares."""
    amplitudes = np.zeros(basis.shape[1])
    for _ in range(5):
        residual = heights - basis @ amplitudes
        scale = np.sum(weights * np.abs(residual)) / np.sum(weights) + 1e-300
        root = np.sqrt(weights / (1 + (residual / scale) ** 2))
        amplitudes = np.linalg.lstsq(root[:, None] * basis, root * heights)[0]
    return amplitudes
