"""The linear algebra of a fit has one thread, and gets its others back."""

import threading

from threadpoolctl import threadpool_info

import petalfit as pf
from petalfit.fitting.solver.threads import one_thread


def threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_a_fit_has_one_thread():
    before, inside = threads(), []
    cloud = pf.Sepal().sample(400, seed=0, noise=0.02)
    pf.fit(pf.Sepal(), cloud, progress=lambda text: inside.append(threads()))
    assert inside
    assert all(found == {1} for found in inside)
    assert threads() == before


def test_fits_side_by_side_give_the_threads_back():
    before, begun, leave = threads(), threading.Event(), threading.Event()

    def other() -> None:
        with one_thread():
            begun.set()
            leave.wait()

    thread = threading.Thread(target=other)
    thread.start()
    begun.wait()
    with one_thread():
        assert threads() == {1}
    assert threads() == {1}
    leave.set()
    thread.join()
    assert threads() == before
