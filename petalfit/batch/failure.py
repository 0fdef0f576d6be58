"""What a batch has in the place of a result."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from petalfit.observations import TargetError


@dataclasses.dataclass(frozen=True)
class FitFailure:
    """A target of a batch that has no result. It says so under the same names as a `FitResult`.

    Attributes:
        status: "unusable": the target, or the options for it, cannot be used; "error": something else
            was raised; "crashed": the process that fitted it died, of too little memory for instance.
        message: What was wrong, in words.
        converged: False.
    """

    status: str
    message: str
    converged: ClassVar[bool] = False

    @classmethod
    def of(cls, error: Exception) -> FitFailure:
        """Of what a fit raised."""
        if isinstance(error, TargetError):
            return cls("unusable", str(error))
        return cls("error", f"{type(error).__name__}: {error}")
