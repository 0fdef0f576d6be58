"""The names of models on the command line."""

from typing import Literal

from petalfit.components import model_named
from petalfit.fitting import DEFAULT
from petalfit.surfaces import AbstractSurface


def kind_of(name: str | None) -> type[AbstractSurface] | Literal["auto"]:
    """The component with this name, the default petal for None, or "auto".

    Raises:
        TargetError: There is no component with this name.
    """
    if name is None:
        return DEFAULT
    return "auto" if name == "auto" else model_named(name)
