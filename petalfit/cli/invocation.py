"""The command line of the running process, which files can name as their origin."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_arguments: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


@contextmanager
def invoked_with(arguments: Sequence[str]) -> Iterator[None]:
    """Makes `command_line` return that of these arguments, given without the program's name."""
    token = _arguments.set(tuple(arguments))
    try:
        yield
    finally:
        _arguments.reset(token)


def command_line() -> str:
    """The running command in the notation of a shell; empty outside of a command."""
    arguments = _arguments.get()
    return shlex.join(["petalfit", *arguments]) if arguments else ""
