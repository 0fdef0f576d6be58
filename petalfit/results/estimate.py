"""What every fit returns: values, how sure they are, and which of them the data do not determine."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from statistics import NormalDist

import equinox as eqx
import numpy as np
from jaxtyping import Float64

from petalfit.components import Parameter, parameters
from petalfit.results.status import Status
from petalfit.results.warning import FitWarning

# A rival whose χ² is worse by less than this is one. By chance alone, the best of the some 200
# frequencies that ribs could have leads by 2 log 200.
CLEAR_LEAD = 20.0
# Standard errors between two ends from which they are different.
APART = 3.0


@dataclasses.dataclass(frozen=True)
class Start:
    """A start that was tried: what it was, what it reached, and how far it is from the best.

    Attributes:
        label: What distinguishes it, "rib_frequency 19.8" for instance.
        values: The free parameters that it reached.
        rms: Root mean square distance that it reached, in the target's unit.
        delta_chi2: How much worse its χ² is than the best one's; 0 for the best.
    """

    label: str
    values: dict[str, float]
    rms: float
    delta_chi2: float


def rivals(
    starts: tuple[Start, ...], stderr: Mapping[str, float], declared: Mapping[str, Parameter]
) -> tuple[Start, ...]:
    """The starts that ended almost as well as the first, and elsewhere.

    "Elsewhere" is three standard errors away in a parameter that is determined, or a part of the typical
    range away in one that is not.
    """

    def apart(start: Start, name: str) -> float:
        error = stderr[name]
        if not np.isfinite(error):
            error = float(np.ptp(declared[name].typical)) / 12**0.5 / 10
        return abs(start.values[name] - starts[0].values[name]) / max(error, 1e-300)

    return tuple(
        start
        for start in starts[1:]
        if start.delta_chi2 < CLEAR_LEAD and max(apart(start, name) for name in stderr) > APART
    )


def standard_errors(
    names: Sequence[str], covariance: Float64[np.ndarray, "p p"]
) -> dict[str, float]:
    """Standard errors by name; infinite where the covariance is."""
    return dict(zip(names, map(float, np.sqrt(np.diag(covariance))), strict=True))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """The outcome of a fit.

    Attributes:
        model: What was fitted.
        values: Every parameter of the model by name, fixed ones included.
        stderr: Standard errors of the free parameters; `inf` where the data do not determine them.
        identifiable: Whether the data determine a free parameter: its standard error is below 0.3
            standard deviations of its typical range.
        names: The free parameters, in the order of `covariance`.
        covariance: Shape (p, p); rows and columns of what is not identifiable are `inf`.
        status: How the fit ended; `status.meaning` says it in a sentence.
        reason: How the fit ended, in words and with its numbers.
        notes: What a reader should know besides, and what is no reason for doubt.
        warnings: Reasons to doubt the result, each with its kind; empty if there are none.
        steps: Iterations of the final solve.
        starts: What each start reached, best first.
        timings: Seconds that finding "starts", "polishing", "errors" and "compiling" took; what did not
            happen is missing. Compiling is what a process does once for each size of target.
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
        """Whether the solver settled, on a model that follows the target."""
        return self.status is Status.CONVERGED

    @property
    def outcome(self) -> str:
        """How the fit ended and what a reader should know besides, without the warnings."""
        return "; ".join([self.reason, *self.notes])

    @property
    def message(self) -> str:
        """How the fit ended, notes and warnings, on one line."""
        return "; ".join([self.outcome, *self.warnings])

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
            (low, high) by name; (−inf, inf) where the data cannot tell.
        """
        reach = quantile(level)
        return {
            name: (self.values[name] - reach * error, self.values[name] + reach * error)
            for name, error in self.stderr.items()
        }


def quantile(level: float) -> float:
    """How many standard deviations to either side of its mean a Gaussian stays within.

    Args:
        level: The probability of that, in (0, 1).
    """
    if not 0 < level < 1:
        raise ValueError(f"level must lie between 0 and 1; received {level}")
    return float(NormalDist().inv_cdf(0.5 + 0.5 * level))
