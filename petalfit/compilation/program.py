"""A pure function and its compiled programs, one for every structure and shape of its arguments."""

from __future__ import annotations

import contextvars
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Generic, TypeVar

import jax
import numpy as np

from petalfit.compilation.buckets import ROWS, blocks
from petalfit.compilation.stopwatch import stage, unwatched
from petalfit.compilation.store import current_store, is_double

R = TypeVar("R")
_WORKER = "petalfit-program"  # how names of the threads begin
_CORES = os.cpu_count() or 1


class Program(Generic[R]):
    """A function that is compiled. Within `use_store` programs are loaded from a folder and saved there.

    Call it outside of jitted functions, with arrays of NumPy or jax.
    """

    def __init__(self, function: Callable[..., R]) -> None:
        self._function = function

    def __call__(self, *args: Any) -> R:
        leaves, structure = jax.tree.flatten(args)
        return current_store().program(self._function, structure, leaves)(*leaves)

    def map(self, calls: Sequence[tuple]) -> list[R]:
        """The results of several calls, computed side by side; arguments differ in their values alone.

        Within a call that is itself computed beside others, they are computed one after the other.

        Returns:
            The results, in arrays of NumPy.
        """
        first, structure = jax.tree.flatten(calls[0])
        program = current_store().program(self._function, structure, first)
        return _side_by_side(program, [jax.tree.leaves(args) for args in calls])


class RowProgram(Program[R]):
    """A program that treats all rows alike and alone, so that no number of them compiles another one.

    The rows are computed in blocks, side by side.

    Args:
        function: The function. Its result is an array, or a tree of arrays, with a row for each row.
        count: The number of arguments that have rows, the last ones.
    """

    def __init__(self, function: Callable[..., R], count: int) -> None:
        super().__init__(function)
        self._count = count

    def __call__(self, *args: Any) -> R:
        """The result of the function, in arrays of NumPy."""
        others, rows = args[: -self._count], args[-self._count :]
        split = [blocks(np.asarray(part), size=ROWS) for part in rows]
        leaves, structure = jax.tree.flatten((*others, *(part[0] for part in split)))
        program = current_store().program(self._function, structure, leaves)
        same = leaves[: -self._count]
        found = _side_by_side(program, [[*same, *block] for block in zip(*split, strict=True)])
        size = len(rows[0])
        # NumPy's concatenation compiles nothing for a new number of blocks, as jax's would.
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:size], *found)


def _side_by_side(program: Callable, calls: Sequence[list]) -> list:
    """The results of a program for several lists of leaves, on all cores."""

    def share(some: Sequence[list]) -> list:
        return [jax.tree.map(np.asarray, program(*leaves)) for leaves in some]

    double = is_double()

    def beside(some: Sequence[list]) -> list:
        # Settings of jax belong to a thread.
        with jax.enable_x64(double):
            return share(some)

    parts = min(_CORES, len(calls))
    if parts == 1 or threading.current_thread().name.startswith(_WORKER):
        # A worker that waits for others, while they wait for it, would wait for ever.
        return share(calls)
    others = [_workers().submit(beside, calls[part::parts]) for part in range(1, parts)]
    shares = [share(calls[::parts]), *(future.result() for future in others)]
    return [shares[k % parts][k // parts] for k in range(len(calls))]


def prepared(function: Callable[[], object]) -> Callable[[], None]:
    """Runs a function beside what follows, so that the programs it calls are compiled by then.

    Returns:
        A function that waits until they are, and raises what went wrong.
    """
    double = is_double()

    def run() -> None:
        with unwatched(), jax.enable_x64(double):
            function()

    future = _workers().submit(contextvars.copy_context().run, run)

    def wait() -> None:
        with stage("compiling"):
            future.result()

    return wait


@cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_CORES, _WORKER)
