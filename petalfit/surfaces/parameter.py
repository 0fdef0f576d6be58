"""Declarations of model parameters, from which bounds, starts, reports and help are derived."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

_KEY = "petalfit.parameter"
# Metadata of a field whose component's parameters count as those of the whole, by their plain names.
WRAPPED = {"petalfit.wrapped": True}
Tree = TypeVar("Tree", bound=eqx.Module)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """The declaration of a parameter: what is known of it before any data.

    Attributes:
        symbol: The symbol of the paper, for tables and reports.
        unit: "length" (the target's unit), "rad", or "1" for a pure number.
        bounds: The open interval that a fit never leaves.
        typical: The range that starts are drawn from. It is also the prior range against which a fit
            decides whether the data determine the parameter.
        meaning: A description in one line, for tables and help.
        fixed: Whether a fit holds the parameter at its value unless `free` names it.
    """

    symbol: str
    unit: str
    bounds: tuple[float, float]
    typical: tuple[float, float]
    meaning: str
    fixed: bool = False


def parameter(default: float, **declaration: Any) -> Any:
    """A field of a component that is declared as a `Parameter`.

    Args:
        default: The value of the field if none is given.
        declaration: The attributes of a `Parameter`: symbol, unit, bounds, typical, meaning and,
            optionally, fixed.
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
    """A parameter field for a length in the unit of the surface."""
    return _in_unit("length", default, symbol, bounds, typical, meaning, fixed)


def angle(
    default: float,
    symbol: str,
    bounds: tuple[float, float],
    typical: tuple[float, float],
    meaning: str,
    fixed: bool = False,
) -> Any:
    """A parameter field for an angle in rad."""
    return _in_unit("rad", default, symbol, bounds, typical, meaning, fixed)


def number(
    default: float,
    symbol: str,
    bounds: tuple[float, float],
    typical: tuple[float, float],
    meaning: str,
    fixed: bool = False,
) -> Any:
    """A parameter field for a number without a unit."""
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
    """The value of a parameter, by its name such as "h" or "filament.h"."""
    return attrgetter(name)(model)


def with_value(model: Tree, name: str, value: Any) -> Tree:
    """A copy of the model with another value of one parameter."""
    return eqx.tree_at(attrgetter(name), model, value)


@lru_cache
def leaves_of(structure: Any, names: tuple[str, ...]) -> tuple[int, ...]:
    """The indices of parameters among the leaves of a model, whose structure is a `PyTreeDef`."""
    numbered = jax.tree.unflatten(structure, range(structure.num_leaves))
    return tuple(value_at(numbered, name) for name in names)


def in_doubles(model: Tree) -> Tree:
    """The model with NumPy's doubles for leaves, so that equal shapes mean the same compiled program."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), model)


def batch_of(model: Tree, names: Sequence[str], values: Float[np.ndarray, "k p"]) -> Tree:
    """A batch of k models that differ in some parameters: all leaves have one more axis, the first.

    Args:
        model: A model with the values of all other parameters.
        names: Names of the parameters that differ.
        values: Their values, a row for each model.
    """
    count = len(values)
    batch = jax.tree.map(lambda x: np.broadcast_to(x, (count, *np.shape(x))), model)
    for k, name in enumerate(names):
        batch = with_value(batch, name, values[:, k])
    return batch


def parameters(model: eqx.Module | type[eqx.Module]) -> dict[str, Parameter]:
    """The declared parameters of a component or a pattern, by name, in the order of declaration.

    If a field holds a component, that component's parameters stand at the field's place. Their names are
    dotted ("filament.h"), or plain if the field is `WRAPPED`.

    Args:
        model: A class of components or patterns, or an instance of one.
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
