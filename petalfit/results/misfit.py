"""The part of the distances that is misfit: distances that neighbouring points share are no noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.results.warning import FitWarning, WarningKind
from petalfit.surfaces import Domain, cells

CELLS = 8  # per side of the domain
_SYSTEMATIC = 0.1  # of the squared distances: with noise alone there are none
_ACROSS = ("u < 0", "", "u > 0")
_ALONG = ("base", "", "tip")


class MisfitMap(NamedTuple):
    """Distances averaged over parts of a surface.

    Attributes:
        mean: Mean signed distance over `CELLS` x `CELLS` cells of (u, v), u first; NaN where no point is.
        total: Sum of the weights in each.
        systematic: Part of the squared distances that the means explain, beyond what noise would give
            them: 0 for a model that follows its points, 1 for distances that are misfit alone.
    """

    mean: Float[np.ndarray, "8 8"]
    total: Float[np.ndarray, "8 8"]
    systematic: float

    @classmethod
    def of(
        cls,
        domain: Domain,
        uv: Float[np.ndarray, "n 2"],
        distances: Float[np.ndarray, " n"],
        weights: Float[np.ndarray, " n"],
    ) -> MisfitMap:
        """The map of signed distances at given foot points."""
        cell = cells(domain, uv, CELLS)
        total, sums = np.zeros((CELLS, CELLS)), np.zeros((CELLS, CELLS))
        np.add.at(total, cell, weights)
        np.add.at(sums, cell, weights * distances)
        seen = total > 0
        mean = np.where(seen, sums / np.where(seen, total, 1.0), np.nan)
        squares = float(np.sum(weights * distances**2))
        explained = float(np.sum(sums[seen] ** 2 / total[seen])) / max(squares, 1e-300)
        # Means of noise alone explain as much of it as there are cells for every point.
        by_chance = min(np.count_nonzero(seen) / max(np.sum(total), 1.0), 1.0)
        systematic = float(max(explained - by_chance, 0.0) / max(1 - by_chance, 1e-9))
        return cls(mean, total, systematic)

    @property
    def worst(self) -> str:
        """The part of the surface with most of the misfit, in words."""
        misfit = np.nan_to_num(self.total * self.mean**2)
        thirds = np.minimum(3 * np.arange(CELLS) // CELLS, 2)
        parts = np.zeros((3, 3))
        np.add.at(parts, np.ix_(thirds, thirds), misfit)
        across, along = np.unravel_index(int(np.argmax(parts)), parts.shape)
        end, side = _ALONG[along], _ACROSS[across]
        if not end:
            return f"along the margin {side}" if side else "in the middle"
        return f"near the {end}, on the side {side}" if side else f"near the {end}"

    def warnings(self) -> list[FitWarning]:
        """One warning if the surface cannot follow its points; none if it can."""
        if self.systematic < _SYSTEMATIC:
            return []
        text = (
            f"the model cannot follow all of the target: {100 * self.systematic:.0f} % of the squared "
            f"distances are systematic, most of them {self.worst}"
        )
        return [FitWarning(text, WarningKind.SYSTEMATIC)]
