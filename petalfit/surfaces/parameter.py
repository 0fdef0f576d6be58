"""The one declaration of a model parameter, from which bounds, starts, reports and help follow."""

from __future__ import annotations

import dataclasses
from operator import attrgetter
from typing import Any, TypeVar

import equinox as eqx

_KEY = "petalfit.parameter"
# Metadata of a field that holds a component whose parameters are the whole's own, by their plain names.
WRAPPED = {"petalfit.wrapped": True}
Tree = TypeVar("Tree", bound=eqx.Module)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What is known of a parameter before any data.

    Attributes:
        symbol: As the paper writes it, for tables and reports.
        unit: "length" (the target's unit), "rad", or "1" for a pure number.
        bounds: A fit never leaves this open interval.
        typical: The range that starts are drawn from; also the prior range against which a fit judges
            whether the data determine the parameter.
        meaning: One line for tables and help.
        fixed: Held at its value unless named in `free`.
    """

    symbol: str
    unit: str
    bounds: tuple[float, float]
    typical: tuple[float, float]
    meaning: str
    fixed: bool = False


def parameter(default: float, **declaration: Any) -> Any:
    """A field of a component, declared as a `Parameter`.

    Args:
        default: Its value when not given.
        declaration: The attributes of a `Parameter`: symbol, unit, bounds, typical, meaning and, if need
            be, fixed.
    """
    return eqx.field(default=default, metadata={_KEY: Parameter(**declaration)})


def length(
    default: float,
    symbol: str,
    bounds: tuple[float, float],
    typical: tuple[float, float],
    meaning: str,
    fixed: bool = False,
) -> Any:
    """A field that is a length in the unit of the surface."""
    return _in_unit("length", default, symbol, bounds, typical, meaning, fixed)


def angle(
    default: float,
    symbol: str,
    bounds: tuple[float, float],
    typical: tuple[float, float],
    meaning: str,
    fixed: bool = False,
) -> Any:
    """A field that is an angle in rad."""
    return _in_unit("rad", default, symbol, bounds, typical, meaning, fixed)


def number(
    default: float,
    symbol: str,
    bounds: tuple[float, float],
    typical: tuple[float, float],
    meaning: str,
    fixed: bool = False,
) -> Any:
    """A field without a unit."""
    return _in_unit("1", default, symbol, bounds, typical, meaning, fixed)


def _in_unit(
    unit: str,
    default: float,
    symbol: str,
    bounds: tuple[float, float],
    typical: tuple[float, float],
    meaning: str,
    fixed: bool,
) -> Any:
    return parameter(
        default,
        symbol=symbol,
        unit=unit,
        bounds=bounds,
        typical=typical,
        meaning=meaning,
        fixed=fixed,
    )


def value_at(model: eqx.Module, name: str) -> Any:
    """The value of a parameter by its name, "h" or "filament.h"."""
    return attrgetter(name)(model)


def with_value(model: Tree, name: str, value: Any) -> Tree:
    """The model with another value of a parameter."""
    return eqx.tree_at(attrgetter(name), model, value)


def parameters(model: eqx.Module | type[eqx.Module]) -> dict[str, Parameter]:
    """The declared parameters of a component or a pattern, by name, in their order of declaration.

    Those of a component in a field come at the field's place, by dotted names ("filament.h"), or by their
    own if the field is `WRAPPED`.

    Args:
        model: A class, or an instance of one.
    """
    found = {}
    for field in dataclasses.fields(model):
        if _KEY in field.metadata:
            found[field.name] = field.metadata[_KEY]
            continue
        part = getattr(model, field.name, None)
        if part is None and field.default_factory is not dataclasses.MISSING:
            part = field.default_factory()
        if isinstance(part, eqx.Module):
            prefix = "" if field.metadata == WRAPPED else f"{field.name}."
            found |= {prefix + name: declared for name, declared in parameters(part).items()}
    return found
