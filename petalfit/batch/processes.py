"""Parallel evaluation of a function over many jobs, in order, in processes that may crash."""

from __future__ import annotations

import gc
import itertools
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple, TypeVar

import loky

from petalfit.batch.interrupt import undisturbed

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")

# The number of jobs read ahead per worker, so that all have work while the first job is slow.
_AHEAD = 8
# The number of seconds for which idle workers are kept between batches.
_PATIENCE = 60


class Crash(NamedTuple):
    """The outcome of a job whose process has died."""


def cores() -> int:
    """The number of processes that can run at once, given the limits of containers and affinities."""
    return loky.cpu_count()


def environment() -> dict[str, str]:
    """The environment of a worker process: one thread, because there is a process for every core."""
    threads = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {**dict.fromkeys(threads, "1"), "JAX_PLATFORMS": "cpu"}


def in_order(
    function: Callable[[Job], Outcome], jobs: Iterable[Job], workers: int
) -> Iterator[Outcome | Crash]:
    """Yields the outcome of a function for each job, in the order of the jobs.

    Jobs are taken from the iterable a few at a time. If a process dies, by a signal or because memory
    ran out, the jobs that may have caused it are tried once more, each in a process of its own. The
    function and its results may be defined in a script or a notebook. If the iteration ends early, the
    processes are killed.

    Args:
        function: The function, which is called in another process. Its exceptions are raised here.
        jobs: The jobs, as any iterable.
        workers: The number of processes.
    """
    jobs = iter(jobs)
    # A suspect, a job that may have killed a process, has no future: it will be tried alone.
    waiting: deque[tuple[Job, Future | None]] = deque()
    ended = False
    try:
        while True:
            for job in itertools.islice(jobs, _AHEAD * workers - len(waiting)):
                waiting.append((job, _submit(function, job, workers)))
            if not waiting:
                ended = True
                return
            job, future = waiting.popleft()
            try:
                outcome = _alone(function, job) if future is None else future.result()
            except BrokenProcessPool:
                # Jobs begin in this order, so the next ones were running too and are suspects.
                suspects = workers - 1
                for k, (other, its) in enumerate(waiting):
                    if its is not None and its.done() and its.exception() is not None:
                        again = None if suspects > 0 else _submit(function, other, workers)
                        waiting[k] = (other, again)
                        suspects -= 1
                outcome = _alone(function, job)
            yield outcome
    finally:
        if not ended:
            with undisturbed():
                _executor(workers).shutdown(wait=True, kill_workers=True)


def _executor(workers: int) -> Any:
    return loky.get_reusable_executor(
        workers, timeout=_PATIENCE, initializer=_begin, env=environment()
    )


def _submit(function: Callable[[Job], Outcome], job: Job, workers: int) -> Future:
    try:
        return _executor(workers).submit(function, job)
    except BrokenProcessPool:  # it broke just now; the next executor is a new one
        return _executor(workers).submit(function, job)


def _alone(function: Callable[[Job], Outcome], job: Job) -> Outcome | Crash:
    executor = loky.ProcessPoolExecutor(1, initializer=_begin, env=environment())
    try:
        return executor.submit(function, job).result()
    except BrokenProcessPool:
        return Crash()
    finally:
        executor.shutdown(wait=True, kill_workers=True)


def _begin() -> None:
    """Prepares a new process."""
    # The process that waits for this one handles Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Nearly all objects that imports and tracing create stay alive, so collecting is wasted time.
    gc.set_threshold(200_000, *gc.get_threshold()[1:])
