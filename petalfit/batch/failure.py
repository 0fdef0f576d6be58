"""What a batch has in the place of a result."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from petalfit.observations import TargetError
from petalfit.results import Status


@dataclasses.dataclass(frozen=True)
class FitFailure:
    """A target of a batch that has no result. It says so under the names that a `FitResult` has too.

    Attributes:
        status: UNUSABLE, ERROR or CRASHED; `status.meaning` says it in a sentence.
        message: What was wrong, in words.
        converged: False.
    """

    status: Status
    message: str
    converged: ClassVar[bool] = False

    @classmethod
    def of(cls, error: Exception) -> FitFailure:
        """Of what a fit raised."""
        if isinstance(error, TargetError):
            return cls(Status.UNUSABLE, str(error))
        return cls(Status.ERROR, f"{type(error).__name__}: {error}")
