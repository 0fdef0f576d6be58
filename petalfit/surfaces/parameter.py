"""The one declaration of a model parameter, from which bounds, starts, reports and help follow."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx

from petalfit.surfaces.surface import AbstractSurface

_KEY = "petalfit.parameter"


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
    """A field of a component, declared as a `Parameter`; `default` is its value when not given."""
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
    return parameter(
        default,
        symbol=symbol,
        unit="length",
        bounds=bounds,
        typical=typical,
        meaning=meaning,
        fixed=fixed,
    )


def parameters(model: eqx.Module | type[eqx.Module]) -> dict[str, Parameter]:
    """The declared parameters of a component or a pattern, by field name, in their order of declaration.

    Those of a component within an instance come at its field's place: a surface's by their own names, the
    parts of an assembly by dotted ones, as in "filament.h".
    """
    found = {}
    for field in dataclasses.fields(model):
        part = getattr(model, field.name, None)
        if _KEY in field.metadata:
            found[field.name] = field.metadata[_KEY]
        elif isinstance(part, AbstractSurface) and isinstance(model, AbstractSurface):
            found |= parameters(part)
        elif isinstance(part, eqx.Module):
            found |= {f"{field.name}.{name}": p for name, p in parameters(part).items()}
    return found
