"""The result of any fit: values, their errors, and which of them the data do not determine."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from statistics import NormalDist

import equinox as eqx
import numpy as np
from jaxtyping import Float64

from petalfit.components import Parameter, parameters
from petalfit.results.status import Status
from petalfit.results.warning import FitWarning, in_few_words

# An end is a rival if its χ² is worse by less than this. By chance alone, the best of the about 200
# frequencies that ribs could have leads by 2 log 200.
CLEAR_LEAD = 20.0
# The number of doubts that are shown at once; the others wait until somebody asks.
_FEW = 3
# Two ends are different if a parameter differs by at least this many standard errors.
APART = 3.0


@dataclasses.dataclass(frozen=True)
class Start:
    """A start that was tried, and the end that it reached.

    Attributes:
        label: A name that distinguishes the start, such as "rib_frequency 19.8".
        values: Values of the free parameters at its end.
        rms: Root mean square distance at its end, in the target's unit.
        delta_chi2: Difference of its χ² from that of the answer. In an image it is negative where the
            other way round fits slightly better, but has the base above the tip.
    """

    label: str
    values: dict[str, float]
    rms: float
    delta_chi2: float


def rivals(
    starts: tuple[Start, ...],
    stderr: Mapping[str, float],
    declared: Mapping[str, Parameter],
    inflation: float = 1.0,
) -> tuple[Start, ...]:
    """The starts that ended almost as well as the first, and elsewhere.

    "Elsewhere" means at least three standard errors away in a parameter that is determined, or a part of
    the typical range away in one that is not. Differences of χ² are divided by `inflation`, because a
    misfit makes them too large (Rotnitzky and Jewell 1990).
    """

    def apart(start: Start, name: str) -> float:
        error = stderr[name]
        if not np.isfinite(error):
            error = float(np.ptp(declared[name].typical)) / 12**0.5 / 10
        return abs(start.values[name] - starts[0].values[name]) / max(error, 1e-300)

    return tuple(
        start
        for start in starts[1:]
        if start.delta_chi2 < CLEAR_LEAD * inflation
        and max((apart(start, name) for name in stderr), default=0.0) > APART
    )


def standard_errors(
    names: Sequence[str], covariance: Float64[np.ndarray, "p p"]
) -> dict[str, float]:
    """Standard errors by name; infinite for parameters whose covariance is."""
    return dict(zip(names, map(float, np.sqrt(np.diag(covariance))), strict=True))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """The outcome of a fit.

    Attributes:
        model: The fitted model.
        values: Values of all parameters of the model by name, including fixed ones.
        stderr: Standard errors of the free parameters by name; `inf` if the data do not determine them.
        identifiable: Whether the data determine each free parameter, by name: its standard error is
            below 0.3 standard deviations of its typical range.
        names: Names of the free parameters, in the order of `covariance`.
        covariance: Covariance of the free parameters, shape (p, p); rows and columns of those that are
            not identifiable are `inf`.
        status: The outcome of the fit; `status.meaning` explains it in a sentence.
        reason: The outcome of the fit in words, with its numbers.
        notes: Further facts about the result that are no reason for doubt.
        warnings: Reasons to doubt the result, each with its kind, the likeliest to matter first; empty if
            there are none.
        steps: The number of iterations of the final solve.
        starts: The starts and what each of them reached, the best first.
        timings: Seconds spent in the stages "starts", "polishing", "errors" and "compiling"; stages that
            did not take place are missing. A process compiles once for each size of target.
    """

    model: eqx.Module
    values: dict[str, float]
    stderr: dict[str, float]
    identifiable: dict[str, bool]
    names: tuple[str, ...]
    covariance: Float64[np.ndarray, "p p"]
    status: Status
    reason: str
    notes: tuple[str, ...] = ()
    warnings: tuple[FitWarning, ...] = ()
    steps: int
    starts: tuple[Start, ...]
    timings: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether the solver converged, to a model that follows the target."""
        return self.status is Status.CONVERGED

    @property
    def outcome(self) -> str:
        """The reason and the notes on one line, without the warnings."""
        return "; ".join([self.reason, *self.notes])

    @property
    def doubts(self) -> list[str]:
        """The warnings in few sentences, one for all that say the same about different parameters."""
        return in_few_words(self.warnings, self.names)

    @property
    def doubts_in_two(self) -> tuple[list[str], list[str]]:
        """The doubts that are shown at once, and the others."""
        doubts = self.doubts
        return doubts[:_FEW], doubts[_FEW:]

    @property
    def message(self) -> str:
        """The reason, the notes and the first of the doubts on one line."""
        first, rest = self.doubts_in_two
        more = [f"{len(rest)} more warning{'s' * (len(rest) > 1)}"] if rest else []
        return "; ".join([self.outcome, *first, *more])

    @property
    def rivals(self) -> tuple[Start, ...]:
        """Other starts that ended elsewhere, almost as well: the data hardly distinguish them."""
        return rivals(self.starts, self.stderr, self.declared)

    @property
    def declared(self) -> dict[str, Parameter]:
        """The declarations of all parameters that have a value, by name."""
        return parameters(self.model)

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Symmetric confidence intervals of the free parameters.

        Args:
            level: Probability that the interval covers the truth, in (0, 1).

        Returns:
            (low, high) by name; (−inf, inf) for parameters that the data do not determine.
        """
        reach = quantile(level)
        return {
            name: (self.values[name] - reach * error, self.values[name] + reach * error)
            for name, error in self.stderr.items()
        }


def quantile(level: float) -> float:
    """The half-width, in standard deviations, of the central interval of a Gaussian.

    Args:
        level: The probability of the interval, in (0, 1).
    """
    if not 0 < level < 1:
        raise ValueError(f"level must lie between 0 and 1; received {level}")
    return float(NormalDist().inv_cdf(0.5 + 0.5 * level))
