"""The abstract observation: its size, unit, digest and JSON, and which of its data count."""

from __future__ import annotations

import abc
import json
import zlib
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float64

from petalfit.observations.errors import TargetError


class AbstractObservation(abc.ABC):
    """Data that were observed of a surface, which a fit compares with the surface.

    A new kind is a subclass. It is registered under its `kind`, the name that files use; the residuals,
    pictures and controls of the kind are registered where they are defined
    (`petalfit.fitting.silhouettes.observing`, `petalfit.report.shown`, `petalfit.studio.drawn`).

    Attributes:
        kind: The name of the kind in files and reports, for instance "cloud".
        unit: The unit of its distances: "length" (the target's unit of length) or "px".
        notes: What is odd about the data, and what was done about it when they were read, in whole
            sentences. Fits repeat it as warnings.
    """

    kind: ClassVar[str]
    unit: ClassVar[str]
    notes: tuple[str, ...] = ()
    kinds: ClassVar[dict[str, type[AbstractObservation]]] = {}

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        AbstractObservation.kinds[cls.kind] = cls

    @property
    @abc.abstractmethod
    def size(self) -> float:
        """The diagonal of the observed object, in the unit of the distances."""

    @property
    @abc.abstractmethod
    def extent(self) -> Float64[np.ndarray, " d"]:
        """The sides of its bounding box or of its image, in the unit of the distances; (d,)."""

    @property
    @abc.abstractmethod
    def described(self) -> str:
        """A description in a few words with its numbers, for instance "2,000 points"."""

    @abc.abstractmethod
    def arrays(self) -> tuple[dict[str, Any], list[Float64[np.ndarray, "..."] | None]]:
        """All data that a fit uses: first those that are not arrays, as JSON, then the arrays."""

    @abc.abstractmethod
    def to_json(self) -> dict[str, Any]:
        """The observation as lossless JSON; the member "kind" names its kind."""

    @classmethod
    @abc.abstractmethod
    def from_json(cls, content: dict[str, Any]) -> AbstractObservation:
        """The observation that `to_json` has described."""

    def used(self, weights: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """A mask of the data that count, given their weights at the end of a fit."""
        return weights > 0

    def outliers(self, weights: Float64[np.ndarray, " n"]) -> int:
        """The number of data that a fit treats as outliers, given their weights at its end."""
        del weights
        return 0

    def each_once(self) -> AbstractObservation:
        """The observation without duplicates, which are not additional observations."""
        return self

    def counting(self, weights: Float64[np.ndarray, " n"]) -> AbstractObservation:
        """The observation with the weights of its data at the end of a fit, if those may have changed."""
        del weights
        return self

    def content(self) -> Iterator[bytes]:
        """The data that a fit uses, as bytes for a digest; equal data give equal bytes."""
        head, arrays = self.arrays()
        yield json.dumps([type(self).__name__, _shapes(arrays), *head.values()]).encode()
        for array in arrays:
            if array is not None:
                yield np.ascontiguousarray(array, "<f8").tobytes()


def _shapes(arrays: list[Float64[np.ndarray, "..."] | None]) -> list[tuple[int, ...] | None]:
    return [None if array is None else array.shape for array in arrays]


def observation_from_json(content: dict[str, Any]) -> AbstractObservation:
    """The observation, of any kind, that a file describes.

    Raises:
        TargetError: The kind is unknown, or the description is damaged.
    """
    kind = AbstractObservation.kinds.get(str(content.get("kind")))
    if kind is None:
        raise TargetError(
            f"there is no kind of observation {content.get('kind')!r}; the kinds are "
            f"{', '.join(AbstractObservation.kinds)}."
        )
    try:
        return kind.from_json(content)
    except TargetError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError, zlib.error) as error:
        raise TargetError(f"the {kind.kind} is damaged ({error!r}).") from error
