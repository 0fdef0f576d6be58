"""The registry of families: petalfit's own, and those that users add."""

from __future__ import annotations

from petalfit.components import bare
from petalfit.fitting.families.assembly.family import AssemblyFamily
from petalfit.fitting.families.blade.family import BladeFamily
from petalfit.fitting.families.component import ComponentFamily, RectangleFamily
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.peony.family import PeonyFamily
from petalfit.fitting.families.spline.family import SplineFamily
from petalfit.surfaces import AbstractSurface

_FAMILIES: dict[type[AbstractSurface], AbstractFamily] = {family.kind: family for family in (
    PeonyFamily(),
    BladeFamily(),
    SplineFamily(),
    ComponentFamily(),
    RectangleFamily(),
    AssemblyFamily(),
)}  # fmt: skip
# The default petal, and the one to try first on a scan of any petal or leaf.
DEFAULT, FOR_SCANS = PeonyFamily.kind, BladeFamily.kind


def register(family: AbstractFamily) -> AbstractFamily:
    """Adds a family, which is then used for its kind of models, and in model="auto" if `is_petal`.

    Call it in the module that defines the kind: the processes of a batch import that module, and so know
    the family too. A family that is registered later for the same kind replaces the earlier one.

    Args:
        family: The family.

    Returns:
        The family.

    Raises:
        TypeError: The argument is no family, or has no kind.
    """
    if not isinstance(family, AbstractFamily):
        raise TypeError(f"register takes an instance of a family; received {family!r}")
    kind = getattr(family, "kind", None)
    if not (isinstance(kind, type) and issubclass(kind, AbstractSurface)):
        raise TypeError(f"{type(family).__name__} needs a kind: the class of its models")
    _FAMILIES[kind] = family
    return family


def family_of(model: AbstractSurface | type[AbstractSurface]) -> AbstractFamily:
    """The family of a model, whether `Posed` or not, or of a class of models."""
    kind = model if isinstance(model, type) else type(bare(model))
    return next(_FAMILIES[base] for base in kind.__mro__ if base in _FAMILIES)


def families() -> tuple[AbstractFamily, ...]:
    """All registered families."""
    return tuple(_FAMILIES.values())


def petals() -> tuple[AbstractFamily, ...]:
    """The families that take part in model="auto"."""
    return tuple(family for family in _FAMILIES.values() if family.is_petal)
