"""The command line that a process is running, so that what it writes can say what made it."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_arguments: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


@contextmanager
def invoked_with(arguments: Sequence[str]) -> Iterator[None]:
    """Within it, `command_line` is that of these arguments, the program's name left out."""
    token = _arguments.set(tuple(arguments))
    try:
        yield
    finally:
        _arguments.reset(token)


def command_line() -> str:
    """As a shell takes it; empty outside of a command."""
    arguments = _arguments.get()
    return shlex.join(["petalfit", *arguments]) if arguments else ""
