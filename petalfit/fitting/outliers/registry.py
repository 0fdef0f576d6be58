"""All losses, by name."""

from __future__ import annotations

from petalfit.fitting.outliers.linear import Linear
from petalfit.fitting.outliers.loss import AbstractLoss
from petalfit.fitting.outliers.robust import Robust
from petalfit.observations import TargetError

LOSSES: dict[str, AbstractLoss] = {loss.name: loss for loss in (
    Linear(),
    Robust(),
)}  # fmt: skip


def loss_named(name: str) -> AbstractLoss:
    """The loss that has a given name.

    Raises:
        TargetError: No loss has this name.
    """
    if name not in LOSSES:
        known = " or ".join(map(repr, LOSSES))
        raise TargetError(f"loss must be {known}; received {name!r}.")
    return LOSSES[name]
