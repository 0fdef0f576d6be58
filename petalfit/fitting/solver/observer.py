"""The observer of a fit: it receives progress in words, the surface after every round, and timings."""

from __future__ import annotations

import contextvars
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from petalfit.compilation import watched
from petalfit.residuals import AbstractTerm, TangentDistance, frames
from petalfit.results import FitRecord
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True, eq=False)
class Glimpse:
    """The state of a fit between two rounds.

    Attributes:
        model: The model in the frame in which the fit works. While a pose is fitted, this is not the
            target's frame.
        points: The points of the cloud in that frame, shape (n, 3); n is 0 in a fit of masks.
        distances: Signed normal distance of each point, shape (n,).
    """

    model: AbstractSurface
    points: Float[np.ndarray, "n 3"]
    distances: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, model: AbstractSurface, terms: Sequence[AbstractTerm]) -> Glimpse:
        """The model, with the points of all terms that have points."""
        points, distances = [np.empty((0, 3))], [np.empty(0)]
        for term in terms:
            if isinstance(term, TangentDistance):
                used = term.data.weights > 0
                points.append(term.data.points[used])
                here = frames(model, term.uv)
                distances.append(here.distance(term.data.points)[used])
        return cls(model, np.concatenate(points), np.concatenate(distances))


@dataclasses.dataclass(frozen=True)
class Observer:
    """Functions that are called during a fit and do not change it. An exception in one ends the fit.

    Attributes:
        progress: Called with a line of text whenever a stage of the fit begins; or None.
        onlooker: Called with a `Glimpse` after every round; or None.
        collector: Called with every petal of a flower as soon as it has been fitted; or None.
    """

    progress: Callable[[str], None] | None = None
    onlooker: Callable[[Glimpse], None] | None = None
    collector: Callable[[FitRecord], None] | None = None


_current: contextvars.ContextVar[Observer] = contextvars.ContextVar("observer", default=Observer())  # noqa: B039


@contextmanager
def _observed_by(observer: Observer) -> Iterator[None]:
    token = _current.set(observer)
    try:
        yield
    finally:
        _current.reset(token)


@contextmanager
def reporting_to(progress: Callable[[str], None] | None) -> Iterator[dict[str, float]]:
    """Reports the stages of all fits in the block to a function, and measures their time.

    Args:
        progress: The function, called with a line of text; None for no reports.

    Yields:
        Seconds by name of the stage, complete when the block ends.
    """
    observer = dataclasses.replace(_current.get(), progress=progress)
    with _observed_by(observer), watched("starts") as watch:
        yield watch.seconds


@contextmanager
def looking_on(onlooker: Callable[[Glimpse], None]) -> Iterator[None]:
    """Calls a function with a `Glimpse` after every round of every fit in the block."""
    with _observed_by(dataclasses.replace(_current.get(), onlooker=onlooker)):
        yield


@contextmanager
def watching_petals(collector: Callable[[FitRecord], None]) -> Iterator[None]:
    """Calls a function with each petal of a flower as soon as it has been fitted in the block.

    Later stages may join, replace or drop petals.
    """
    with _observed_by(dataclasses.replace(_current.get(), collector=collector)):
        yield


@contextmanager
def prefixed(prefix: str) -> Iterator[None]:
    """Puts a prefix, such as the name of a family, before every line that is reported in the block."""
    outer = _current.get()
    observer = dataclasses.replace(outer, progress=lambda text: _say(outer, f"{prefix}: {text}"))
    with _observed_by(observer):
        yield


def report(text: str) -> None:
    """Reports which stage of the fit begins."""
    _say(_current.get(), text)


def is_looked_on() -> bool:
    """Whether there is an onlooker, for whom the state of the fit is worth putting together."""
    return _current.get().onlooker is not None


def show(model: AbstractSurface, terms: Sequence[AbstractTerm]) -> None:
    """Passes the state of the fit, with the points of the terms, to the onlooker, if there is one."""
    onlooker = _current.get().onlooker
    if onlooker is not None:
        onlooker(Glimpse.of(model, terms))


def collect(petal: FitRecord) -> None:
    """Passes a petal of a flower to the function that collects them, if there is one."""
    collector = _current.get().collector
    if collector is not None:
        collector(petal)


def _say(observer: Observer, text: str) -> None:
    if observer.progress is not None:
        observer.progress(text)
