"""A pure function and its compiled programs, one for every structure and shape of its arguments."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar

import jax

from petalfit.compilation.stopwatch import moved
from petalfit.compilation.store import current_store, options

R = TypeVar("R")


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
