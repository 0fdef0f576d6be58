"""Surfaces that are another surface in some other place."""

from __future__ import annotations

import abc
from typing import Any, ClassVar

from petalfit.surfaces import AbstractSurface, Domain, Oscillation


class AbstractCarrier(AbstractSurface):
    """A surface with the domain of another, that answers for a model's parameters by their plain names.

    A subclass says where the other surface is carried, and holds the model in a field that is `WRAPPED`.

    Attributes:
        model_field: Name of that field.
    """

    model_field: ClassVar[str]

    @property
    @abc.abstractmethod
    def carried(self) -> AbstractSurface:
        """The surface that domain, edges and orientation are those of."""

    @property
    def domain(self) -> Domain:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.carried.domain

    @property
    def orientation(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.carried.orientation

    @property
    def edges(self) -> tuple[bool, bool]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.carried.edges

    @property
    def regular(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.carried.regular

    @property
    def oscillation(self) -> Oscillation | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.carried.oscillation

    def __getattr__(self, name: str) -> Any:
        # Only asked for what the carrier itself does not have: the model's parameters.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(object.__getattribute__(self, self.model_field), name)
