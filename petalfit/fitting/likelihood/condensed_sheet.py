"""The likelihood of an open surface beside a large cloud, which is condensed to cells."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Float

from petalfit.compilation import blocks
from petalfit.fitting.coordinates import Box
from petalfit.fitting.likelihood.cells import Cells, condense
from petalfit.fitting.likelihood.emptiness import Emptiness
from petalfit.fitting.likelihood.relief import beside_many
from petalfit.fitting.likelihood.sheet import NUISANCES, Sheet, SheetCost
from petalfit.surfaces import AbstractSurface

ENOUGH = 4096  # points of a cloud that is not condensed
FINE, COARSE = Cells(32, 48, 0.5), Cells(16, 20, 1.0)


@dataclasses.dataclass(frozen=True, eq=False)
class CondensedSheet(Sheet):
    """The likelihood of a large cloud near a surface: two points for each cell.

    Attributes:
        cloud: The likelihood of the cloud itself.
        scattered: Σ w |x − x̄|² of its points about those that stand for them.
        uv: The places of these points on the surface, shape (n, 2).
    """

    cloud: Sheet
    scattered: float
    uv: Float[np.ndarray, "n 2"]

    @classmethod
    def of(
        cls, cloud: Sheet, surface: AbstractSurface, blur: float, cells: Cells
    ) -> CondensedSheet:
        """Condenses a cloud near a surface, see `condense`."""
        found = condense(cloud.points, cloud.weights, surface, blur, cells)
        return cls(found.points, found.weights, cloud, found.scattered, found.uv)

    @property
    def whole(self) -> Sheet:
        return self.cloud

    def cost(
        self,
        box: Box,
        z: Float[np.ndarray, " q"],
        places: Float[np.ndarray, "m 2"],
        steps: int,
    ) -> SheetCost:
        found = super().cost(box, z, places, steps)
        lost = self.scattered * float(np.exp(-2 * z[-NUISANCES]))
        found.gradient[-NUISANCES] -= lost
        found.information[-NUISANCES, -NUISANCES] += 2 * lost
        return found._replace(cost=found.cost + 0.5 * lost)

    def nearest(self, surface: AbstractSurface) -> Float[np.ndarray, "m 2"]:
        """The places of the points; every surface that is asked for is near to the one that has them."""
        return np.concatenate(blocks(self.uv))

    def beside(
        self, surface: AbstractSurface, places: Float[np.ndarray, "m 2"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """The same for all points of the cloud, which are looked up anew."""
        return beside_many(surface, self.cloud.points)

    @cached_property
    def _emptiness(self) -> Emptiness:
        return self.cloud._emptiness
