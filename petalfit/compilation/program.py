"""A pure function and its compiled programs, one for every structure and shape of its arguments."""

from __future__ import annotations

import contextvars
import os
import threading
import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, cached_property
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from petalfit.compilation.buckets import split_into
from petalfit.compilation.stopwatch import moved, stage, unwatched
from petalfit.compilation.store import current_store, is_double, options

R = TypeVar("R")
_WORKER = "petalfit-program"  # how names of the threads begin


class _Compiled(threading.local):
    """The number of programs that jax has compiled in this thread; its cache's size may not show it."""

    programs = 0


_compiled = _Compiled()


def _count(event: str, duration_secs: float, **more: object) -> None:
    _compiled.programs += event == "/jax/core/compile/backend_compile_duration"


jax.monitoring.register_event_duration_secs_listener(_count)


class Program(Generic[R]):
    """A jitted function. Within `use_store` its programs are loaded from a folder and saved there.

    Call it outside other jitted functions, with arrays of NumPy or jax.
    """

    def __init__(self, function: Callable[..., R]) -> None:
        self._function = function
        self._mapped: set[Hashable] = set()

    @cached_property
    def _jitted(self) -> Callable[..., R]:
        return jax.jit(self._function, compiler_options=options())

    def __call__(self, *args: Any) -> R:
        store = current_store()
        if store is None:
            known, began = _compiled.programs, time.perf_counter()
            result = self._jitted(*args)
            if _compiled.programs > known:
                moved(time.perf_counter() - began, "compiling")
            return result
        return store.call(self._function, args)

    def map(self, calls: Sequence[tuple]) -> list[R]:
        """The results of several calls, computed side by side; arguments differ in their values alone.

        Within a call that is itself computed beside others, they are computed one after the other.
        """
        double = is_double()

        def call(args: tuple) -> R:
            # Settings of jax belong to a thread.
            with jax.enable_x64(double):
                return jax.block_until_ready(self(*args))

        def beside(args: tuple) -> R:
            with unwatched():
                return call(args)

        if threading.current_thread().name.startswith(_WORKER):
            # A worker that waits for others, while they wait for it, would wait for ever.
            return [call(args) for args in calls]
        leaves, structure = jax.tree.flatten(calls[0])
        form = current_store(), structure, tuple(map(np.shape, leaves)), double
        # The first call of a form compiles its program, or loads it, and the others find it.
        first = [] if form in self._mapped else [call(calls[0])]
        self._mapped.add(form)
        rest = [
            _workers().submit(contextvars.copy_context().run, beside, args) for args in calls[1:]
        ]
        return [*(first or [call(calls[0])]), *(future.result() for future in rest)]


class RowProgram(Program[R]):
    """A program that treats all rows alike and alone, so that a large number of them compiles nothing.

    Many rows are computed in blocks of `BLOCK`, side by side.

    Args:
        function: The function. Its result is an array, or a tree of arrays, with a row for each row.
        arguments: Indices of the arguments that have rows.
    """

    def __init__(self, function: Callable[..., R], arguments: Sequence[int]) -> None:
        super().__init__(function)
        self._arguments = arguments

    def __call__(self, *args: Any) -> R:
        number = split_into(len(args[self._arguments[0]]))
        if number == 1:
            return super().__call__(*args)
        blocks = {k: np.split(np.asarray(args[k]), number) for k in self._arguments}
        found = self.map(
            [
                tuple(blocks[k][block] if k in blocks else arg for k, arg in enumerate(args))
                for block in range(number)
            ]
        )
        # NumPy's concatenation compiles nothing for a new number of blocks, as jax's would.
        return jax.tree.map(lambda *parts: jnp.asarray(np.concatenate(parts)), *found)


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
    return ThreadPoolExecutor(os.cpu_count() or 1, _WORKER)
