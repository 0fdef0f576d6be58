"""The error of a fit that failed numerically."""

from __future__ import annotations

from petalfit.results import Estimate


class FitError(RuntimeError):
    """The error of a fit of usable data that did not converge.

    Attributes:
        result: The result of the fit as it ended.
    """

    def __init__(self, message: str, result: Estimate) -> None:
        super().__init__(message)
        self.result = result
