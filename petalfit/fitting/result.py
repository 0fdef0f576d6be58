"""The result of a fit: its record, with methods that make a report or a profile of it."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable

from petalfit.fitting.inference.importance import draws_of
from petalfit.fitting.profile import profile_of
from petalfit.observations import TargetError
from petalfit.report import write_report
from petalfit.results import Draws, FitRecord


class FitResult(FitRecord):
    """The outcome of a fit of a component to observations. See `FitRecord` for its attributes."""

    def report(self, path: str | os.PathLike[str]) -> None:
        """Write one self-contained HTML page with the parameter table and pictures."""
        write_report(self, path)

    def draws(self, n: int = 1000, seed: int = 0) -> Draws:
        """Draws of the free parameters from their posterior, with the typical ranges as priors.

        They are drawn from the Gaussian approximation inside the bounds, and for one cloud without a
        discrepancy drawn again with Pareto-smoothed importance weights, so that they follow the
        likelihood. Read `k_hat`.

        Args:
            n: The number of draws.
            seed: The seed of the random choices.

        Raises:
            TargetError: No parameter was free, or the fit has no errors.
            ValueError: `n` is not positive.
        """
        if n < 1:
            raise ValueError(f"n must be a positive number of draws; received {n}")
        if self.posterior is None or not self.posterior.names:
            raise TargetError("this fit has no errors to draw parameters from.")
        return draws_of(self, n, seed)

    def with_profile(
        self, name: str, points: int = 11, progress: Callable[[str], None] | None = None
    ) -> FitResult:
        """The result with the profile likelihood of a parameter added. It takes a fit for every point.

        Unlike a covariance, a profile shows asymmetric limits and a second minimum.

        Args:
            name: The name of a free parameter.
            points: The number of values at which the parameter is held, over 5 standard errors to either
                side, or over the typical range if the parameter is not determined.
            progress: A function that is called with a line of text for every point.

        Raises:
            TargetError: The parameter was not fitted.
        """
        profile = profile_of(self, name, points, progress)
        return dataclasses.replace(self, profiles=self.profiles | {name: profile})
