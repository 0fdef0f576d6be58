"""The exception that unusable input raises."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


class TargetError(ValueError):
    """A target that cannot be used.

    The message says in one or two sentences what was wrong, what was expected and what to do.
    """


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Puts the path of a file before the messages of errors that do not begin with it."""
    try:
        yield
    except TargetError as error:
        text, name = str(error), os.fspath(path)
        raise TargetError(text if text.startswith(name) else f"{name}: {text}") from None
