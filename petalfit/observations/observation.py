"""What every kind of observation answers: size, unit, digest, JSON, and which of its data count."""

from __future__ import annotations

import abc
import json
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float64

from petalfit.observations.errors import TargetError


class AbstractObservation(abc.ABC):
    """Something that was seen of a surface, and that a fit compares with it.

    A new kind is a subclass. It is registered under its `kind`, by which files name it; residuals,
    pictures and controls of the kind are registered where they are made
    (`petalfit.fitting.likelihood.observing`, `petalfit.report.shown`, `petalfit.studio.drawn`).

    Attributes:
        kind: The word for it in files and reports, "cloud" for instance.
        unit: The unit of its distances: "length", the target's, or "px".
    """

    kind: ClassVar[str]
    unit: ClassVar[str]
    kinds: ClassVar[dict[str, type[AbstractObservation]]] = {}

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        AbstractObservation.kinds[cls.kind] = cls

    @property
    @abc.abstractmethod
    def size(self) -> float:
        """The diagonal of what was seen, in the unit of the distances."""

    @property
    @abc.abstractmethod
    def extent(self) -> Float64[np.ndarray, " d"]:
        """The sides of the box that holds it, or of its image, in the unit of the distances; (d,)."""

    @property
    @abc.abstractmethod
    def described(self) -> str:
        """What it is, in a few words with its numbers: "2,000 points" for instance."""

    @abc.abstractmethod
    def arrays(self) -> tuple[dict[str, Any], list[Float64[np.ndarray, "..."] | None]]:
        """All that a fit looks at: what is no array, as JSON, and the arrays."""

    @abc.abstractmethod
    def to_json(self) -> dict[str, Any]:
        """The observation as JSON holds it, lossless; "kind" is its kind."""

    @classmethod
    @abc.abstractmethod
    def from_json(cls, content: dict[str, Any]) -> AbstractObservation:
        """The observation that `to_json` described."""

    def used(self, weights: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Which data count, given the weights that they had at the end of a fit."""
        return weights > 0

    def outliers(self, weights: Float64[np.ndarray, " n"]) -> int:
        """How many data a fit takes for outliers, given the weights that they had at its end."""
        del weights
        return 0

    def each_once(self) -> AbstractObservation:
        """The same without data that repeat others, which are no observations more."""
        return self

    def counting(self, weights: Float64[np.ndarray, " n"]) -> AbstractObservation:
        """The same with the weights that its data had at the end of a fit, if they may have changed."""
        del weights
        return self

    def content(self) -> Iterator[bytes]:
        """The numbers that a fit looks at, for a digest: the same for the same data."""
        head, arrays = self.arrays()
        yield json.dumps([type(self).__name__, _shapes(arrays), *head.values()]).encode()
        for array in arrays:
            if array is not None:
                yield np.ascontiguousarray(array, "<f8").tobytes()


def _shapes(arrays: list[Float64[np.ndarray, "..."] | None]) -> list[tuple[int, ...] | None]:
    return [None if array is None else array.shape for array in arrays]


def observation_from_json(content: dict[str, Any]) -> AbstractObservation:
    """The observation of whatever kind that a file describes.

    Raises:
        TargetError: The kind is not known.
    """
    kind = AbstractObservation.kinds.get(content["kind"])
    if kind is None:
        raise TargetError(
            f"there is no kind of observation {content['kind']!r}; the kinds are "
            f"{', '.join(AbstractObservation.kinds)}."
        )
    return kind.from_json(content)
