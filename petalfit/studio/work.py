"""Work in the background: as many pieces at a time as there are cores, each of which can be cancelled."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable


class CalledOff(Exception):
    """The work has been cancelled."""


class Workshop:
    """Runs as many pieces of work at a time as there are cores; the others wait.

    Fits spend their time in compiled code, which lets other threads run. The threads end with the
    process, even in the middle of their work.
    """

    def __init__(self) -> None:
        self._room = threading.Semaphore(os.cpu_count() or 1)

    def begin(self, work: Work, do: Callable[[Work], None]) -> None:
        """Runs `do(work)` in a thread as soon as a core is free; it checks whether it was cancelled."""

        def run() -> None:
            with contextlib.suppress(CalledOff), self._room:
                try:
                    do(work)
                finally:
                    work.call_off()

        threading.Thread(target=run, name="fit", daemon=True).start()


class Work:
    """One piece of work, which checks now and then whether it has been cancelled."""

    def __init__(self) -> None:
        self._off = threading.Event()

    @property
    def running(self) -> bool:
        """Whether the work is running or waiting for a core, and not cancelled."""
        return not self._off.is_set()

    def call_off(self) -> None:
        """Cancels the work: it ends at its next check."""
        self._off.set()

    def check(self) -> None:
        """Returns if the work has not been cancelled.

        Raises:
            CalledOff: The work has been cancelled.
        """
        if self._off.is_set():
            raise CalledOff
