"""The threads of the linear algebra that a fit leaves to NumPy and SciPy."""

from __future__ import annotations

from contextlib import AbstractContextManager

from threadpoolctl import threadpool_limits


def one_thread() -> AbstractContextManager:
    """Makes BLAS and LAPACK use one thread within a block of code, in the whole process.

    Matrices of a fit have a few hundred rows. Divided among threads they take longer: on 16 cores, or on
    two that are busy, up to twenty times as long, because the threads spin while they wait for others.
    Of several threads of Python, the first one that comes sets the limit and ends it.
    """
    return threadpool_limits(limits=1, user_api="blas")
