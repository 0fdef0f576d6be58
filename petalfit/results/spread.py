"""How alike several petals are: the mean and the spread of each number, apart from its errors."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from petalfit.results.layout import Quantity

if TYPE_CHECKING:
    from petalfit.results.record import FitRecord

_FEWEST = 3  # petals of which a spread can be told


@dataclasses.dataclass(frozen=True)
class Spread:
    """A number of several petals: what they have in common, and how much they differ.

    Attributes:
        mean: Its mean over all petals of this kind, with the standard error.
        deviation: Its standard deviation between petals, without what their errors add, with the standard
            error.
        count: The number of petals that determine it.
    """

    mean: Quantity
    deviation: Quantity
    count: int


def spreads_of(petals: Sequence[FitRecord]) -> dict[str, Spread]:
    """The spread of every trait and parameter of some petals. See `FlowerRecord.spread`."""
    if not petals:
        return {}
    found: dict[str, Spread | None] = {}
    for name in petals[0].traits:
        traits = [petal.traits[name] for petal in petals]
        found[name] = spread_of([t.value for t in traits], [t.stderr for t in traits])
    for name in petals[0].names:
        if name not in found:
            found[name] = spread_of_parameter(petals, name)
    return {name: spread for name, spread in found.items() if spread is not None}


def spread_of_parameter(petals: Sequence[FitRecord], name: str) -> Spread | None:
    """The spread of a parameter of some petals; None if fewer than three of them determine it."""
    known = [petal.identifiable[name] for petal in petals]
    errors = [p.stderr[name] if k else math.inf for p, k in zip(petals, known, strict=True)]
    return spread_of([petal.values[name] for petal in petals], errors)


def spread_of(
    values: Sequence[float] | Float[np.ndarray, " k"],
    errors: Sequence[float] | Float[np.ndarray, " k"],
) -> Spread | None:
    """The spread of values that have independent errors, by the method of Paule and Mandel (1982).

    The variance between petals is the one with which the weighted squares of the differences from the
    mean are as large as expected; 0 if the errors alone explain them.

    Args:
        values: The value of each petal.
        errors: Their standard errors; infinite where a petal does not determine the value.

    Returns:
        The spread; None if fewer than three petals determine the value.
    """
    known = np.isfinite(errors) & (np.asarray(errors) > 0)
    value, variance = np.asarray(values, float)[known], np.asarray(errors, float)[known] ** 2
    count = len(value)
    if count < _FEWEST:
        return None

    def weights(between: float) -> Float[np.ndarray, " k"]:
        return 1 / (variance + between)

    def excess(between: float) -> float:
        w = weights(between)
        return float(np.sum(w * (value - np.average(value, weights=w)) ** 2)) - (count - 1)

    most = float(np.sum((value - value.mean()) ** 2)) + float(variance.max())
    between = 0.0
    if excess(0.0) > 0:
        from scipy.optimize import root_scalar

        between = float(root_scalar(excess, bracket=(0.0, most)).root)
    w = weights(between)
    mean = Quantity(float(np.average(value, weights=w)), 1 / math.sqrt(float(w.sum())))
    of_variance, deviation = math.sqrt(2 / float(np.sum(w**2))), math.sqrt(between)
    # Near zero the error of the square root is that of the variance's upper end.
    error = min(of_variance / max(2 * deviation, 1e-300), math.sqrt(of_variance))
    return Spread(mean, Quantity(deviation, error), count)
