"""Maps of misfit: the part of the distances that neighbouring points share, which is not noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.results.warning import FitWarning, WarningKind
from petalfit.surfaces import Domain, cells

CELLS = 8  # per side of the domain
_SYSTEMATIC = 0.1  # systematic part of the squared distances from which there is a warning
_ACROSS = ("u < 0", "", "u > 0")
_ALONG = ("base", "", "tip")


class MisfitMap(NamedTuple):
    """A map of distances averaged over the cells of a surface.

    Attributes:
        mean: Mean signed distance over `CELLS` x `CELLS` cells of (u, v), u first; NaN for empty cells.
        total: Sum of the weights in each cell.
        systematic: Part of the squared distances that the means explain, beyond what they would explain
            of pure noise: 0 for a model that follows its points, 1 for distances that are all misfit.
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
        # The means of pure noise explain a part of it: the number of cells divided by that of points.
        by_chance = min(np.count_nonzero(seen) / max(np.sum(total), 1.0), 1.0)
        systematic = float(max(explained - by_chance, 0.0) / max(1 - by_chance, 1e-9))
        return cls(mean, total, systematic)

    @property
    def worst(self) -> str:
        """The name of the part of the surface with most of the misfit, in words."""
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
