"""Access to the numbers of a flower by name: "petal.dy" for all petals, "petal_3.dy" for one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

from petalfit.components import parameters
from petalfit.flowers.attachment import Attachment
from petalfit.flowers.flower import Flower, Series
from petalfit.surfaces import Parameter, value_at, with_value


class FlowerError(ValueError):
    """A flower that cannot be grown as described; the message says why and what to do."""


def with_settings(flower: Flower, settings: Mapping[str, float]) -> Flower:
    """The flower with some of its numbers replaced.

    Args:
        flower: The flower.
        settings: The new values by name. A name is an organ ("receptacle", "pedicel", all of a series
            as "petal", or one as "petal_3"), a dot, and a parameter of the organ ("dy", "filament.h") or
            of its attachment ("opening").

    Raises:
        FlowerError: A name is unknown, or a value is out of range.
    """
    for name, value in settings.items():
        flower = _with_setting(flower, name, value)
    return flower


def _with_setting(flower: Flower, name: str, value: float) -> Flower:
    organ, _, path = name.partition(".")
    if organ == "receptacle" or (organ == "pedicel" and flower.pedicel is not None):
        part = getattr(flower, organ)
        new = with_value(part, path, checked(value, path, declared(part, path, organ), organ))
        return eqx.tree_at(lambda f: getattr(f, organ), flower, new)
    for number, series in enumerate(flower.series):
        if organ == series.name or organ in series.names:
            k = slice(None) if organ == series.name else series.names.index(organ)
            new = _with_number(series, organ, path, k, value)
            return eqx.tree_at(lambda f, number=number: f.series[number], flower, new)
    known = ["receptacle", *(["pedicel"] if flower.pedicel is not None else [])]
    known += [f"{s.name} (and {s.names[0]} to {s.names[-1]})" if len(s) > 1 else s.name
              for s in flower.series]  # fmt: skip
    raise FlowerError(
        f"the {flower.name} has no organ {organ!r}; its organs are {', '.join(known)}."
    )


def _with_number(series: Series, organ: str, path: str, k: slice | int, value: float) -> Series:
    field = "attachment" if path in parameters(Attachment) else "organ"
    part = getattr(series, field)
    others = list(parameters(Attachment)) if field == "organ" else []
    one = series.one(0) if field == "organ" else part
    value = checked(value, path, declared(one, path, organ, others), organ)
    row = np.array(value_at(part, path), np.float64)
    row[k] = value
    return eqx.tree_at(lambda s: getattr(s, field), series, with_value(part, path, row))


def declared(organ: eqx.Module, path: str, name: str, others: list[str] | None = None) -> Parameter:
    """The declaration of a parameter of an organ.

    Args:
        organ: The organ, or one organ of a series.
        path: The name of the parameter within the organ.
        name: The name of the organ, for the error message.
        others: Further parameter names that the error message lists.

    Raises:
        FlowerError: There is no such parameter.
    """
    known = parameters(organ)
    if path not in known:
        names = ", ".join([*known, *(others or [])])
        raise FlowerError(f"{name} has no parameter {path!r}; it has {names}.")
    return known[path]


def checked(value: Any, path: str, parameter: Parameter, name: str) -> float:
    """Checks that a value is a number within the parameter's range, and returns it.

    Raises:
        FlowerError: The value is not a number, or out of range.
    """
    low, high = parameter.bounds
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        raise FlowerError(f"{name}.{path} is {value!r}, which is no number.")
    if not (math.isfinite(value) and low <= value <= high):
        raise FlowerError(f"{name}.{path} = {value:g} lies outside its range, {low:g} to {high:g}.")
    return float(value)
