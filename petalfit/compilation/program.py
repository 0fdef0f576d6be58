"""A pure function and its compiled programs, one for every structure and shape of its arguments."""

from __future__ import annotations

import contextvars
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from petalfit.compilation.buckets import ROWS, pad_to
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

        Within a call that is itself computed beside others, they are computed one after the other. The
        function must not solve many linear systems at once: XLA divides them among its threads, and two
        programs that do so at the same time may wait for each other for ever.

        Returns:
            The results, in arrays of NumPy.
        """
        first, structure = jax.tree.flatten(calls[0])
        program = current_store().program(self._function, structure, first)
        return _side_by_side(program, [jax.tree.leaves(args) for args in calls])


class RowProgram:
    """A program that treats all rows alike and alone, so that no number of them compiles another one.

    It loops over short blocks of rows, as many as there are: a few rows take a short time, and what is
    computed of a block stays in the processor's cache. Many rows are shared among the cores.

    Args:
        function: The function. Its result is an array with a row for each row.
        count: The number of arguments that have rows, the last ones.
    """

    def __init__(self, function: Callable[..., jax.Array], count: int) -> None:
        self._function = _by_blocks(function, count)
        self._count = count

    def __call__(self, *args: Any) -> np.ndarray:
        """The rows of the result."""
        others, rows = args[: -self._count], [np.asarray(x) for x in args[-self._count :]]
        parts = _parts(len(rows[0]))
        filled = [[pad_to(x[part], ROWS) for x in rows] for part in parts]
        leaves, structure = jax.tree.flatten((np.float64(0), *others, *filled[0]))
        program = current_store().program(self._function, structure, leaves)
        same = leaves[1 : -self._count]
        # The numbers of blocks are doubles, because these travel in one array with the other scalars.
        counts = [np.float64(-(-(part.stop - part.start) // _block())) for part in parts]
        calls = [[count, *same, *own] for count, own in zip(counts, filled, strict=True)]
        found = _side_by_side(program, calls)
        return np.concatenate(
            [x[: part.stop - part.start] for x, part in zip(found, parts, strict=True)]
        )


def _by_blocks(function: Callable[..., jax.Array], count: int) -> Callable[..., jax.Array]:
    """A function like the given one, for the first blocks of its rows; the other rows are zero."""

    @wraps(function)
    def looped(number: jax.Array, *args: Any) -> jax.Array:
        others, rows = args[:-count], args[-count:]

        def block(first: jax.Array | int) -> jax.Array:
            some = [jax.lax.dynamic_slice_in_dim(x, first, _block()) for x in rows]
            return function(*others, *some)

        def step(k: jax.Array, found: jax.Array) -> jax.Array:
            first = k * _block()
            return jax.lax.dynamic_update_slice_in_dim(found, block(first), first, 0)

        like = jax.eval_shape(block, 0)
        found = jnp.zeros((ROWS, *like.shape[1:]), like.dtype)
        return jax.lax.fori_loop(0, number.astype(int), step, found)

    return looped


@cache
def _block() -> int:
    """The rows of a block: few on a processor, and all on a device that computes them side by side."""
    return 128 if jax.default_backend() == "cpu" else ROWS


def _parts(size: int) -> list[slice]:
    """Parts of so many rows: nearly equal, of whole blocks but for the last one."""
    number = max(-(-size // ROWS), 1)
    length = max(-(-size // (number * _block())), 1) * _block()
    return [slice(k, min(k + length, size)) for k in range(0, max(size, 1), length)]


def _side_by_side(program: Callable, calls: Sequence[list]) -> list:
    """The results of a program for several lists of leaves, on all cores."""
    parts = min(_CORES, len(calls))
    if parts == 1 or threading.current_thread().name.startswith(_WORKER):
        # A worker that waits for others, while they wait for it, would wait for ever.
        return _in_turn(program, calls)
    double = is_double()
    others = [
        _workers().submit(_with_precision, double, program, calls[part::parts])
        for part in range(1, parts)
    ]
    shares = [_in_turn(program, calls[::parts]), *(future.result() for future in others)]
    return [shares[k % parts][k // parts] for k in range(len(calls))]


def _in_turn(program: Callable, calls: Sequence[list]) -> list:
    """The results of a program for several lists of leaves, in arrays of NumPy."""
    return [jax.tree.map(np.asarray, program(*leaves)) for leaves in calls]


def _with_precision(double: bool, program: Callable, calls: Sequence[list]) -> list:
    """The same in a thread of its own, which does not know the precision of the one that asks."""
    with jax.enable_x64(double):
        return _in_turn(program, calls)


def prepared(function: Callable[[], object]) -> Callable[[], None]:
    """Runs a function beside what follows, so that the programs it calls are compiled by then.

    Returns:
        A function that waits until they are, and raises what went wrong.
    """
    double = is_double()

    def run() -> None:
        with unwatched(), jax.enable_x64(double):
            function()

    future = _workers_ahead().submit(contextvars.copy_context().run, run)

    def wait() -> None:
        with stage("compiling"):
            future.result()

    return wait


@cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_CORES, _WORKER)


@cache
def _workers_ahead() -> ThreadPoolExecutor:
    """Others than `_workers`: no call of a program waits until others are compiled."""
    return ThreadPoolExecutor(_CORES, f"{_WORKER}-ahead")
