"""Measurement of the time of a computation by stage."""

from __future__ import annotations

import contextvars
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """A stopwatch that adds up seconds by stage; an inner stage stops the clock of the outer one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._stages: list[str] = []
        self._since = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts the time of a block for the stage `name`."""
        self._stop()
        self._stages.append(name)
        try:
            yield
        finally:
            self._stop()
            self._stages.pop()

    def _stop(self) -> None:
        now = time.perf_counter()
        if self._stages:
            self.seconds[self._stages[-1]] += now - self._since
        self._since = now


_current: contextvars.ContextVar[Stopwatch | None] = contextvars.ContextVar("watch", default=None)


@contextmanager
def watched(stage: str) -> Iterator[Stopwatch]:
    """Yields a stopwatch for a block, which begins in the stage `stage`."""
    watch = Stopwatch()
    token = _current.set(watch)
    try:
        with watch.stage(stage):
            yield watch
    finally:
        _current.reset(token)


@contextmanager
def unwatched() -> Iterator[None]:
    """Hides the stopwatch from a block, which runs in another thread than the one it measures."""
    token = _current.set(None)
    try:
        yield
    finally:
        _current.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Counts the time of a block for the stage `name`, if a stopwatch is running."""
    watch = _current.get()
    if watch is None:
        yield
        return
    with watch.stage(name):
        yield
