"""A function over many jobs in processes of this machine, in order, whatever happens to one of them."""

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

# Jobs that are read ahead, for each worker: all have something to do while the first is slow.
_AHEAD = 8
# Between batches the workers stay, warm, for so many seconds.
_PATIENCE = 60


class Crash(NamedTuple):
    """In the place of an outcome: whatever process worked on this job died."""


def cores() -> int:
    """How many processes can run at once here, limits of containers and affinities considered."""
    return loky.cpu_count()


def environment() -> dict[str, str]:
    """Of a process that computes: one thread, because there is a process for every core."""
    threads = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {**dict.fromkeys(threads, "1"), "JAX_PLATFORMS": "cpu"}


def in_order(
    function: Callable[[Job], Outcome], jobs: Iterable[Job], workers: int
) -> Iterator[Outcome | Crash]:
    """What a function makes of each job, in the order of the jobs.

    Jobs are taken from the iterable a few at a time. If a process dies, by a signal or because memory
    ran out, the jobs that it may have died of are tried once more, each in a process of its own. The
    function and its results may be defined in a script or a notebook. When the iteration ends early
    the processes are killed.

    Args:
        function: Called in another process. What it raises is raised here.
        jobs: Any iterable.
        workers: How many processes.
    """
    jobs = iter(jobs)
    # A suspect has no future: it will be tried alone.
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
                # They began in this order: the next ones were being worked on too.
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
    except BrokenProcessPool:  # only just
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
    """In a new process."""
    # Ctrl-C is for the process that waits for this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Nearly all that imports and tracing make stays.
    gc.set_threshold(200_000, *gc.get_threshold()[1:])
