"""Locks on the folder of a batch, so that no two batches fit the same targets into it at once.

The system holds them for the process and drops them when it ends, however it ends: a lock is never stale.
Where a file system has no locks, batches go on without.
"""

from __future__ import annotations

import errno
import os
import platform
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from petalfit.observations import TargetError

try:
    import fcntl
except ImportError:  # Windows, where batches go on without
    fcntl = None

_HELD = (errno.EWOULDBLOCK, errno.EACCES)


@contextmanager
def locked(out: Path, shard: tuple[int, int]) -> Iterator[None]:
    """Holds the folder for a block: alone, or together with the other shards of the batch.

    Args:
        out: The folder, which exists.
        shard: The number of the share of the targets, from 1, and how many shares there are.

    Raises:
        TargetError: Another process is at work on the same targets.
    """
    number, count = shard
    with ExitStack() as held:
        held.enter_context(_lock(out, ".lock", alone=count == 1))
        if count > 1:
            held.enter_context(_lock(out, f".lock-{number}-of-{count}", alone=True))
        yield


@contextmanager
def _lock(out: Path, name: str, alone: bool) -> Iterator[None]:
    if fcntl is None:
        yield
        return
    try:
        (out / name).touch()
    except OSError as error:
        raise TargetError(f"{out} cannot be written: {error.strerror or error}.") from None
    with open(out / name, "a+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _HELD:
                file.seek(0)
                who = file.read().strip() or "another process"
                raise TargetError(
                    f"{out} is in use: {who} fits the same targets into it. Wait until it has ended, "
                    "or choose another --out."
                ) from None
        if alone:
            file.truncate(0)
            file.write(f"process {os.getpid()} on {platform.node()}\n")
            file.flush()
        try:
            yield
        finally:
            if alone:
                file.truncate(0)
