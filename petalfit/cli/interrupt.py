"""A reliable reaction to Ctrl-C."""

import _thread
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Long enough for cleaning up after the first interrupt, short enough that nobody presses Ctrl-C again.
_AGAIN = 0.7  # seconds


@contextmanager
def insistent_interrupt() -> Iterator[None]:
    """Makes Ctrl-C raise KeyboardInterrupt repeatedly until the block ends.

    Once is not enough: trimesh catches all exceptions of its optional imports, and an exception in a
    callback of the garbage collector, of which jax has one, is dropped.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    # If the signal is ignored or handled already, as by nohup, that stays so.
    if not in_main_thread or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    reminders: list[threading.Timer] = []

    def interrupt(signal_number: int, frame: object) -> None:
        reminder = threading.Timer(_AGAIN, _interrupt_main_thread)
        reminder.daemon = True
        reminders.append(reminder)
        reminder.start()
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        for reminder in reminders:
            reminder.cancel()
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupt_main_thread() -> None:
    if hasattr(signal, "pthread_kill"):
        # A real signal also wakes a thread that waits or sleeps.
        thread = threading.main_thread().ident
        assert thread is not None, "it runs"
        signal.pthread_kill(thread, signal.SIGINT)
    else:
        _thread.interrupt_main()
