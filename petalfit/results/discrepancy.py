"""The discrepancy of a fit: the smooth part of the distances, which the model cannot follow."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Discrepancy:
    """A smooth field on the surface that remains between a model and its points.

    The model of Kennedy and O'Hagan (2001): distances are the sum of a Gaussian field, with a correlation
    that falls with the distance on the surface, and independent noise. Its numbers are estimated by
    restricted likelihood, because the fitted parameters have absorbed a part of the field.

    Attributes:
        deviation: Standard deviation of the field, in the target's unit.
        length: Distance over which it is correlated, in the target's unit.
        noise: Standard deviation of the independent noise, in the target's unit.
        smooth: Whether its correlation is Gaussian; else that of Matérn with ν = 3/2, which is rougher.
        inflation: How many times as large the variances of the parameters are with the field as without
            it, on average. A difference of χ² between two ends counts by this much less.
    """

    deviation: float
    length: float
    noise: float
    smooth: bool
    inflation: float

    @property
    def share(self) -> float:
        """The part of the variance of the distances that is the field's."""
        return self.deviation**2 / (self.deviation**2 + self.noise**2)

    @property
    def described(self) -> str:
        """Its size and length in words: "moves points by ..."."""
        return f"moves points by {self.deviation:.2g} (rms) over lengths of {self.length:.2g}"
