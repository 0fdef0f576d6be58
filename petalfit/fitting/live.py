"""A fit while it runs, shown to whoever looks on."""

from __future__ import annotations

import contextvars
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from petalfit.fitting import programs
from petalfit.residuals import AbstractTerm, TangentDistance
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True, eq=False)
class Glimpse:
    """Where a fit stands between two rounds.

    Attributes:
        model: In the frame in which the fit works; while a pose is sought, that is not the target's.
        points: Of the cloud, in that frame, shape (n, 3); none of a fit of masks.
        distances: Signed normal distance of each, shape (n,).
    """

    model: AbstractSurface
    points: Float[np.ndarray, "n 3"]
    distances: Float[np.ndarray, " n"]


_onlooker: contextvars.ContextVar[Callable[[Glimpse], None] | None] = contextvars.ContextVar(
    "onlooker", default=None
)


@contextmanager
def looking_on(onlooker: Callable[[Glimpse], None]) -> Iterator[None]:
    """While the block runs, every round of every fit in it is shown; what `onlooker` raises ends it."""
    token = _onlooker.set(onlooker)
    try:
        yield
    finally:
        _onlooker.reset(token)


def show(model: AbstractSurface, terms: Sequence[AbstractTerm]) -> None:
    """Shows a model with the terms' points, if anybody looks on."""
    onlooker = _onlooker.get()
    if onlooker is None:
        return
    points, distances = [np.empty((0, 3))], [np.empty(0)]
    for term in terms:
        if isinstance(term, TangentDistance):
            used = np.asarray(term.data.weights) > 0
            points.append(np.asarray(term.data.points)[used])
            here = programs.frames(model, term.uv)
            distances.append(np.asarray(here.distance(term.data.points))[used])
    onlooker(Glimpse(model, np.concatenate(points), np.concatenate(distances)))
