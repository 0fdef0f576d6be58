"""Programs that treat rows alone: in blocks, the result is the same and nothing more is compiled."""

import contextvars
import os
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from petalfit.compilation import (
    ROWS,
    ExecutableStore,
    Program,
    RowProgram,
    prepared,
    use_store,
    watched,
)


def _shifted(shift: jax.Array, factor: float, rows: jax.Array) -> jax.Array:
    norm = jnp.linalg.norm(rows + shift, axis=-1)
    return jnp.concatenate([(rows + shift) * factor, norm[:, None]], axis=1)


@pytest.mark.parametrize("count", [0, 1, 130, ROWS - 1, ROWS, ROWS + 1, 2 * ROWS, 5 * ROWS])
def test_rows_are_the_same_in_blocks(count):
    rows = np.random.default_rng(0).standard_normal((count, 3))
    shift = np.array([1.0, 2.0, 3.0])
    with jax.enable_x64(True):
        found = RowProgram(_shifted, 1)(shift, 2.0, rows)
    assert found.shape == (count, 4)
    np.testing.assert_allclose(found[:, :3], 2 * (rows + shift), rtol=1e-14)
    np.testing.assert_allclose(found[:, 3], np.linalg.norm(rows + shift, axis=-1), rtol=1e-14)


def test_more_rows_compile_nothing(tmp_path):
    program = RowProgram(_shifted, 1)
    seconds = []
    with jax.enable_x64(True), use_store(ExecutableStore(tmp_path)):
        for blocks in (4, 7):
            with watched("computing") as watch:
                program(np.zeros(3), 2.0, np.ones((blocks * ROWS, 3)))
            seconds.append(watch.seconds)
    assert ["compiling" in x for x in seconds] == [True, False]


def test_workers_do_not_wait_for_each_other():
    """Each of them splits its rows, for which no worker is left."""
    program, rows = RowProgram(_shifted, 1), np.ones((4 * ROWS, 3))
    found = []

    def work() -> None:
        found.append(program(np.zeros(3), 2.0, rows))

    for wait in [prepared(work) for _ in range(2 * (os.cpu_count() or 1))]:
        wait()
    assert len(found) == 2 * (os.cpu_count() or 1)
    assert all((x[:, :3] == 2).all() for x in found)


def test_threads_that_need_the_same_program_compile_it_once():
    traced = []

    def slow(x):
        traced.append(x)
        time.sleep(0.2)
        return 2 * x

    program, store, x = Program(slow), ExecutableStore(None), np.arange(3.0)
    with ThreadPoolExecutor(4) as pool, jax.enable_x64(True), use_store(store):
        calls = [
            pool.submit(contextvars.copy_context().run, _in_doubles, program, x) for _ in range(4)
        ]
        for call in calls:
            np.testing.assert_array_equal(call.result(), 2 * x)
    assert len(traced) == 1


def _in_doubles(program, x):
    with jax.enable_x64(True):
        return np.asarray(program(x))
