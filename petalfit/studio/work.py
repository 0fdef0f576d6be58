"""Work in the background: as much at a time as there are cores, and each piece can be called off."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable


class CalledOff(Exception):
    """Nobody wants the work any more."""


class Workshop:
    """Room for as many pieces of work at a time as there are cores; the others wait.

    Fits spend their time in compiled code, which lets other threads run. The threads end with the
    process, whatever they are at.
    """

    def __init__(self) -> None:
        self._room = threading.Semaphore(os.cpu_count() or 1)

    def begin(self, work: Work, do: Callable[[Work], None]) -> None:
        """Runs `do(work)` in a thread as soon as there is room."""

        def run() -> None:
            with contextlib.suppress(CalledOff), self._room:
                try:
                    work.check()
                    do(work)
                finally:
                    work.call_off()

        threading.Thread(target=run, name="fit", daemon=True).start()


class Work:
    """One piece of work, which asks now and then whether it is still wanted."""

    def __init__(self) -> None:
        self._off = threading.Event()

    @property
    def running(self) -> bool:
        """Whether it is still wanted, waiting for room included."""
        return not self._off.is_set()

    def call_off(self) -> None:
        """It ends where it asks next, or never begins."""
        self._off.set()

    def check(self) -> None:
        """Goes on if the work is still wanted.

        Raises:
            CalledOff: It is not.
        """
        if self._off.is_set():
            raise CalledOff
