"""Failures, which replace the results of targets that cannot be fitted."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from petalfit.observations import TargetError
from petalfit.results import Status


@dataclasses.dataclass(frozen=True)
class FitFailure:
    """The failure of one target of a batch, in place of its `FitResult`.

    Its attributes exist under the same names in a `FitResult`.

    Attributes:
        status: UNUSABLE, ERROR or CRASHED; `status.meaning` explains it in a sentence.
        message: The reason, in words.
        converged: Always False.
    """

    status: Status
    message: str
    converged: ClassVar[bool] = False

    @classmethod
    def of(cls, error: Exception) -> FitFailure:
        """The failure for an exception that a fit has raised."""
        if isinstance(error, TargetError):
            return cls(Status.UNUSABLE, str(error))
        text = f"{type(error).__name__}: {error}"
        if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in text:
            return cls(Status.CRASHED, "there was not enough memory for it; give fewer --workers")
        return cls(Status.ERROR, text)
