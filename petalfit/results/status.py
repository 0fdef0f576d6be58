"""The status of a fit: one enum, with the meaning of each outcome."""

from __future__ import annotations

from petalfit.results.meaning import WithMeaning


class Status(WithMeaning):
    """The outcome of a fit. Each member is the string that files and tables hold.

    Attributes:
        meaning: The explanation of the outcome, in one sentence.
    """

    CONVERGED = "converged", "The solver ended at a model that follows the target."
    ROUND_LIMIT = "round_limit", "The parameters still moved when the last iteration ended."
    MISFIT = "misfit", "The target is far from every shape that the model can take."
    NOT_FINITE = "not_finite", "The solver met values that are not finite."
    UNUSABLE = "unusable", "The target, or the options for it, cannot be used."
    ERROR = "error", "The fit raised an error that was not expected."
    CRASHED = "crashed", "The process that fitted the target died, for want of memory for instance."
    NOT_WRITTEN = "not_written", "The result could not be written to its folder."
