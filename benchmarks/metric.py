"""What a benchmark measures, in one form for all of them."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, TypeVar

import numpy as np


@dataclasses.dataclass(frozen=True)
class Metric:
    """One number.

    Attributes:
        name: "suite.what", unique.
        value: The number; the median where there are several.
        unit: "s", "%", "×" for a ratio, "1" for a rate.
        better: Whether "less" or "more" of it is better.
        tolerance: By what part it may be worse than the baseline before the gate fails; None for what
            depends on the machine and is not gated.
        spread: Half the distance of the quartiles, or the standard error of a rate.
        count: How many measurements it is of.
        note: What a reader should know: what was discarded, what failed.
    """

    name: str
    value: float
    unit: str
    better: Literal["less", "more"]
    tolerance: float | None = None
    spread: float = 0.0
    count: int = 1
    note: str = ""

    @classmethod
    def median(
        cls,
        name: str,
        values: Sequence[float],
        unit: str,
        better: Literal["less", "more"],
        **more: Any,
    ) -> Metric:
        """The median of some values; infinite if more than half of them are."""
        kept = np.asarray(values, float)
        middle = float(np.median(kept)) if len(kept) else float("nan")
        finite = kept[np.isfinite(kept)]
        spread = float(np.subtract(*np.percentile(finite, [75, 25]))) / 2 if len(finite) else 0.0
        return cls(name, middle, unit, better, spread=spread, count=len(kept), **more)

    @classmethod
    def rate(
        cls, name: str, successes: Iterable[bool], tolerance: float | None, note: str = ""
    ) -> Metric:
        """The part of the trials that succeeded."""
        trials = np.array([*successes], float)
        share = float(trials.mean())
        error = float(np.sqrt(share * (1 - share) / len(trials)))
        return cls(name, share, "1", "more", tolerance, error, len(trials), note)


T = TypeVar("T")
Tell = Callable[[str], None]
# A suite yields its metrics as they come; the numbers behind the plots go with them.
Suite = Callable[[bool, Tell], Iterator["Metric | Curve"]]


@dataclasses.dataclass(frozen=True)
class Curve:
    """Numbers for a plot.

    Attributes:
        name: "suite.what".
        x: Where.
        y: What was found there.
        x_label: With its unit.
        y_label: With its unit.
        log: Whether both axes are logarithmic.
        group: Curves of one group share a plot.
    """

    name: str
    x: list[float]
    y: list[float]
    x_label: str
    y_label: str
    log: bool = False
    group: str = ""


def timed(function: Callable[[], T], repeats: int) -> tuple[float, T]:
    """The median wall time of repeated calls, and what they give; a first one is discarded."""
    result, times = function(), []
    for _ in range(repeats):
        began = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - began)
    return float(np.median(times)), result


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent k of y ~ xᵏ by least squares of the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
