"""A pure function and its compiled programs, one for every structure and shape of its arguments."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar

import jax

from petalfit.compilation.stopwatch import moved
from petalfit.compilation.store import current_store, options

R = TypeVar("R")


class Program(Generic[R]):
    """A jitted function. Within `use_store` its programs come from a folder and go there.

    Call it outside other jitted functions, with arrays, NumPy's or jax's.
    """

    def __init__(self, function: Callable[..., R]) -> None:
        self._function = function

    @cached_property
    def _jitted(self) -> Callable[..., R]:
        return jax.jit(self._function, compiler_options=options())

    def __call__(self, *args: Any) -> R:
        store = current_store()
        if store is None:
            known, began = self.cache_size(), time.perf_counter()
            result = self._jitted(*args)
            if self.cache_size() > known:
                moved(time.perf_counter() - began, "compiling")
            return result
        return store.call(self._function, args)

    def cache_size(self) -> int:
        """How many programs this process holds for argument shapes met so far."""
        return self._jitted._cache_size()  # pyright: ignore
