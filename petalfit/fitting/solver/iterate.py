"""The iterate of an optimisation, and its end: one type for all solvers."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Generic

import jax
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
    """A point that an optimisation has reached. The last one from a start is called its end.

    A solver sets the first four attributes; the evaluation of an end adds the others.

    Attributes:
        model: The model at this point.
        terms: The terms of the cost, with their foot points and noise.
        rounds: The number of rounds of matching and solving so far.
        moved: Length of the last step in standard errors, the largest over all directions.
        t: Coordinates of the free parameters, for solvers that need them again bit by bit; else None.
        chi2: −2 log likelihood, or a substitute for it; comparable between starts of one fit.
        label: A name that distinguishes the start from other starts.
        information: Fisher information of the free parameters, shape (p, p); NaN if it was not computed.
        score_covariance: Covariance of the derivative of the cost with respect to the free parameters,
            shape (p, p); NaN if it was not computed.
        residuals: The residuals of every observation.
        mixture: The probability of each point to belong to the surface; None without outliers.
        left_out: The part of the points that seemed to lie on a surface before there was a model, but are
            taken for outliers; None if that is not known.
        freedom: Effective number of parameters, if that is not the number of free parameters; else None.
        trait_errors: Standard errors of the traits, if they do not follow from named parameters.
        points_used: The numbers of points by stage, if not all stages used all points.
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
    left_out: float | None = None
    freedom: float | None = None
    trait_errors: dict[str, float] = dataclasses.field(default_factory=dict)
    points_used: dict[str, int] = dataclasses.field(default_factory=dict)

    @property
    def is_finite(self) -> bool:
        """Whether the information was computed and is finite."""
        return bool(np.isfinite(self.information).all())

    def informed(self, share: float) -> Iterate[Model]:
        """The same end with a share of its information: all variances are larger by 1/share."""
        return dataclasses.replace(
            self,
            information=share * self.information,
            score_covariance=share * self.score_covariance,
        )


def best_first(ends: Iterable[Iterate[Model]]) -> list[Iterate[Model]]:
    """Ends by their χ², the least first. Those that have broken are left out, unless all have."""
    ends = [*ends]
    standing = [end for end in ends if _is_standing(end)]
    return sorted(standing or ends, key=lambda end: end.chi2)


def _is_standing(end: Iterate) -> bool:
    """Whether χ² and the model of an end are finite; a start that outliers lead astray may lose both."""
    numbers = [np.asarray(leaf, float) for leaf in jax.tree.leaves(end.model)]
    return not np.isnan(end.chi2) and all(np.isfinite(number).all() for number in numbers)
