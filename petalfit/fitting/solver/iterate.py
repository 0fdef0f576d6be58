"""Where an optimisation stands, or where it ended: one type for all solvers."""

from __future__ import annotations

import dataclasses
from typing import Generic

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Model
from petalfit.fitting.likelihood.mixture import Mixture
from petalfit.fitting.likelihood.observed import Residuals
from petalfit.residuals import AbstractTerm


def _unknown() -> Float[np.ndarray, "1 1"]:
    return np.full((1, 1), np.nan)


@dataclasses.dataclass(frozen=True, eq=False)
class Iterate(Generic[Model]):
    """Where an optimisation stands, or where it ended.

    A solver fills in the first four; what evaluates an end adds the others.

    Attributes:
        model: The model there.
        terms: The terms of the cost, with their foot points and noise.
        rounds: How many alternations of matching and solving were made.
        moved: By how much the last of them moved, in standard errors, the largest over the directions.
        t: Coordinates of the free parameters, where a solver needs the same bits again.
        chi2: −2 log likelihood or what stands for it; comparable between starts of one fit.
        label: What distinguishes the start.
        information: Fisher information of the free parameters, shape (p, p); NaN if it was not computed.
        score_covariance: Covariance of the cost's derivative by them, shape (p, p); likewise.
        residuals: The observations beside the model.
        mixture: Which points belong to the surface, where they may be outliers.
        freedom: How many numbers the fit could choose, if that is not the number of free parameters.
    """

    model: Model
    terms: tuple[AbstractTerm, ...]
    rounds: int
    moved: float
    t: Float[np.ndarray, " p"] | None = None
    chi2: float = np.nan
    label: str = ""
    information: Float[np.ndarray, "q q"] = dataclasses.field(default_factory=_unknown)
    score_covariance: Float[np.ndarray, "q q"] = dataclasses.field(default_factory=_unknown)
    residuals: tuple[Residuals, ...] = ()
    mixture: Mixture | None = None
    freedom: float | None = None

    @property
    def is_finite(self) -> bool:
        """Whether its information was computed and is finite."""
        return bool(np.isfinite(self.information).all())
