"""The configuration of a fit: the model's template, and the names of its free parameters."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import TypeAlias, TypeVar

import numpy as np

from petalfit.colours import AbstractPattern
from petalfit.components import parameters
from petalfit.observations import TargetError
from petalfit.surfaces import AbstractSurface, value_at, with_value

Fittable: TypeAlias = AbstractSurface | AbstractPattern
Component = TypeVar("Component", bound=AbstractSurface)
_INSIDE = 1e-3  # how far inside, in lengths of the typical range


def inside_ranges(model: Component) -> Component:
    """A model whose parameters lie inside their ranges; a fit may have left them at the ends.

    There they may even lie outside by a rounding error.
    """
    for name, parameter in parameters(model).items():
        low, high = parameter.bounds
        value, step = float(value_at(model, name)), _INSIDE * float(np.ptp(parameter.typical))
        if not low < value < high:
            model = with_value(model, name, np.clip(value, low + step, high - step))
    return model


def configuration(
    model: Fittable | type[Fittable],
    free: Iterable[str] | None,
    init: Fittable | None,
) -> tuple[Fittable, tuple[str, ...]]:
    """The template of a fit and the names of its free parameters.

    Args:
        model: A component or a pattern, a class or an instance.
        free: Names of the free parameters; None for all that are not declared fixed.
        init: An instance to start from, which is then the template.

    Raises:
        TypeError: The model cannot be fitted.
        TargetError: A name is not that of a parameter, or a value is out of its range.
    """
    kind = model if inspect.isclass(model) else type(model)
    fittable = inspect.isclass(kind) and issubclass(kind, AbstractSurface | AbstractPattern)
    if not (fittable and parameters(kind)):
        raise TypeError(
            f"model must be a component or a pattern with declared parameters, a class or an "
            f"instance; received {model!r}"
        )
    declared = parameters(kind)
    if init is not None and type(init) is not kind:
        raise TargetError(f"init must be a {kind.__name__}; received a {type(init).__name__}.")
    template = init if init is not None else model() if inspect.isclass(model) else model
    if free is None:
        names = tuple(name for name, p in declared.items() if not p.fixed)
    else:
        wanted = [free] if isinstance(free, str) else list(free)
        unknown = [name for name in wanted if name not in declared]
        if unknown or not wanted:
            raise TargetError(
                f"free names {', '.join(map(repr, unknown)) or 'no parameter'}; the parameters of "
                f"{kind.__name__} are {', '.join(declared)}."
            )
        names = tuple(name for name in declared if name in wanted)
    for name, parameter in declared.items():
        value = float(value_at(template, name))
        low, high = parameter.bounds
        if not low < value < high:
            raise TargetError(
                f"{name} = {value:g} of the start lies outside its range ({low:g}, {high:g}); give "
                "an init inside it."
            )
    return template, names
