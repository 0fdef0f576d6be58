"""Surfaces that place another surface somewhere else."""

from __future__ import annotations

import abc
from typing import Any, ClassVar

from petalfit.surfaces import AbstractSurface, Domain, Oscillation


class AbstractCarrier(AbstractSurface):
    """A surface that carries another one, and gives access to a model's parameters by their plain names.

    A subclass maps the carried surface to its place, and holds the model in a field that is `WRAPPED`.

    Attributes:
        model_field: The name of the field that holds the model.
    """

    model_field: ClassVar[str]

    @property
    @abc.abstractmethod
    def carried(self) -> AbstractSurface:
        """The carried surface, whose domain, edges and orientation this surface has."""

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
        # Python calls this only for names that the carrier does not have: the model's parameters.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(object.__getattribute__(self, self.model_field), name)
