"""What a peer found."""

from __future__ import annotations

from typing import NamedTuple


class Found(NamedTuple):
    """An end of a peer's descent.

    Attributes:
        values: The free parameters.
        seconds: Wall time without compilation.
        steps: Evaluations of the residuals, or of the gradient.
        converged: Whether it stopped by itself.
    """

    values: dict[str, float]
    seconds: float
    steps: int
    converged: bool = True
