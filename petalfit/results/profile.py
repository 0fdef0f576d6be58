"""Profile likelihoods, and the intervals that they give."""

from __future__ import annotations

import dataclasses

import numpy as np

from petalfit.results.estimate import quantile


@dataclasses.dataclass(frozen=True)
class Profile:
    """A profile likelihood: how much worse the best fit is with one parameter held at a value.

    Attributes:
        values: Values at which the parameter was held, ascending.
        delta_chi2: Difference of χ² at each value from the least χ², for masks that of a smooth curve.
    """

    values: tuple[float, ...]
    delta_chi2: tuple[float, ...]

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """The interval in which Δχ² stays below the quantile of χ² with one degree of freedom.

        An end is infinite where Δχ² never rises above that quantile.

        Args:
            level: Probability that the interval covers the truth, in (0, 1).
        """
        limit = quantile(level) ** 2
        cost, best = np.array(self.delta_chi2), int(np.argmin(self.delta_chi2))
        ends = []
        for side, never in ((slice(best, None, -1), -np.inf), (slice(best, None), np.inf)):
            values, costs = np.array(self.values)[side], cost[side]
            above = np.flatnonzero(costs > limit)
            if not len(above):
                ends.append(never)
                continue
            k = int(above[0])
            # Δχ² is nearly a parabola, so its square root is nearly linear.
            low, high = np.sqrt(costs[k - 1]), np.sqrt(costs[k])
            share = (np.sqrt(limit) - low) / (high - low)
            ends.append(float(values[k - 1] + share * (values[k] - values[k - 1])))
        return ends[0], ends[1]
