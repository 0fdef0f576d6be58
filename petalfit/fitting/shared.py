"""Parameters that all petals of a flower share: which can be, and what their common values are."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

from petalfit.fitting.families.registry import family_of
from petalfit.fitting.request.configuration import configuration
from petalfit.fitting.result import FitResult
from petalfit.observations import TargetError
from petalfit.results import (
    FitWarning,
    Quantity,
    Spread,
    WarningKind,
    quantile,
    spread_of_parameter,
)
from petalfit.results.record import FitRecord
from petalfit.surfaces import AbstractSurface, with_value

_ALIKE = quantile(0.95)  # standard errors of a deviation, up to which petals may be alike


def check_shared(model: type[AbstractSurface] | AbstractSurface, shared: Sequence[str]) -> None:
    """Raises an error for names that the petals of a flower cannot share."""
    if not shared:
        return
    template, free = configuration(model, None, None)
    assert isinstance(template, AbstractSurface)
    family, kind = family_of(template), type(template).__name__
    gauges = family.gauges.get("similarity", ())
    may = [name for name in free if name not in gauges] if family.named_errors else []
    if not may:
        raise TargetError(f"a {kind} has no parameters that petals could share; leave shared out.")
    for name in shared:
        if name in gauges:
            raise TargetError(
                f"{name} is held by the unit of each petal's pose, so that it cannot be shared; petals "
                f"may share {', '.join(may)}."
            )
        if name not in may:
            raise TargetError(
                f"shared names {name!r}, which is no free parameter of a {kind}; petals may share "
                f"{', '.join(may)}."
            )


def shared_spreads(petals: Sequence[FitRecord], shared: Sequence[str]) -> dict[str, Spread]:
    """The mean and the deviation of each shared parameter, of petals that were fitted without sharing.

    Raises:
        TargetError: Fewer than three petals determine one of them.
    """
    found = {}
    for name in shared:
        spread = spread_of_parameter(petals, name)
        if spread is None:
            raise TargetError(
                f"fewer than three petals determine {name}, so that a common value is not known; leave "
                "it out of shared."
            )
        found[name] = spread
    return found


def with_common(petal: FitResult, common: Mapping[str, Quantity]) -> FitResult:
    """A petal with the common values, to start from."""
    model = petal.model
    for name, quantity in common.items():
        model = with_value(model, name, quantity.value)
    return dataclasses.replace(petal, model=model)


def about_shared(spreads: Mapping[str, Spread]) -> Iterator[FitWarning]:
    """A warning if petals differ in what they are said to share."""
    unlike = [
        f"{name} ({spread.mean.value:.3g}, standard deviation {spread.deviation.value:.2g})"
        for name, spread in spreads.items()
        if spread.deviation.value > _ALIKE * spread.deviation.stderr
    ]
    if unlike:
        yield FitWarning(
            f"The petals differ in {', '.join(unlike)} by more than their errors: the common value is "
            "only their mean.",
            WarningKind.SYSTEMATIC,
        )
