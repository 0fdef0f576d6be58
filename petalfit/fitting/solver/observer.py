"""The observer of a fit: progress in words, the surface between rounds, and where the time goes."""

from __future__ import annotations

import contextvars
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from petalfit.compilation import watched
from petalfit.fitting.likelihood import programs
from petalfit.residuals import AbstractTerm, TangentDistance
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True, eq=False)
class Glimpse:
    """Where a fit stands between two rounds.

    Attributes:
        model: The model in the frame in which the fit works; while a pose is sought, that is not the
            target's.
        points: The points of the cloud in that frame, shape (n, 3); none in a fit of masks.
        distances: Signed normal distance of each point, shape (n,).
    """

    model: AbstractSurface
    points: Float[np.ndarray, "n 3"]
    distances: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, model: AbstractSurface, terms: Sequence[AbstractTerm]) -> Glimpse:
        """A model with the points of those terms that have any."""
        points, distances = [np.empty((0, 3))], [np.empty(0)]
        for term in terms:
            if isinstance(term, TangentDistance):
                used = np.asarray(term.data.weights) > 0
                points.append(np.asarray(term.data.points)[used])
                here = programs.frames(model, term.uv)
                distances.append(np.asarray(here.distance(term.data.points))[used])
        return cls(model, np.concatenate(points), np.concatenate(distances))


@dataclasses.dataclass(frozen=True)
class Observer:
    """Follows a fit without changing it. What one of its functions raises ends the fit.

    Attributes:
        progress: Called with a line of text whenever a stage of the fit begins; or None.
        onlooker: Called with a `Glimpse` after every round; or None.
    """

    progress: Callable[[str], None] | None = None
    onlooker: Callable[[Glimpse], None] | None = None


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
    """While the block runs, stages are reported to a function, and their seconds are counted.

    Args:
        progress: The function, called with a line of text; None reports to nobody.

    Yields:
        Seconds by stage, complete when the block ends.
    """
    observer = dataclasses.replace(_current.get(), progress=progress)
    with _observed_by(observer), watched("starts") as watch:
        yield watch.seconds


@contextmanager
def looking_on(onlooker: Callable[[Glimpse], None]) -> Iterator[None]:
    """While the block runs, every round of every fit in it is shown to a function."""
    with _observed_by(dataclasses.replace(_current.get(), onlooker=onlooker)):
        yield


@contextmanager
def prefixed(prefix: str) -> Iterator[None]:
    """While the block runs, reported lines begin with a prefix: the name of a family, for instance."""
    outer = _current.get()
    observer = dataclasses.replace(outer, progress=lambda text: _say(outer, f"{prefix}: {text}"))
    with _observed_by(observer):
        yield


def report(text: str) -> None:
    """Says which stage of the fit begins."""
    _say(_current.get(), text)


def show(model: AbstractSurface, terms: Sequence[AbstractTerm]) -> None:
    """Shows where the fit stands, with the points of the terms, if anybody looks on."""
    onlooker = _current.get().onlooker
    if onlooker is not None:
        onlooker(Glimpse.of(model, terms))


def _say(observer: Observer, text: str) -> None:
    if observer.progress is not None:
        observer.progress(text)
