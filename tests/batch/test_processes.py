"""Jobs in processes: in order, a few at a time, and none of them harmed by the death of another."""

import os
import signal
import time

import pytest

from petalfit.batch.processes import Crash, in_order


def double(job: int) -> int:
    if job < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if job == 100:
        raise ArithmeticError("100 is too much")
    time.sleep(0.002 * (job % 5))
    return 2 * job


def test_outcomes_are_in_order_and_jobs_are_taken_a_few_at_a_time():
    taken = []

    def jobs():
        for job in range(60):
            taken.append(job)
            yield job

    for done, outcome in enumerate(in_order(double, jobs(), 2)):
        assert outcome == 2 * done
        assert len(taken) <= done + 20
    assert done == 59


def test_a_job_that_kills_its_process_harms_no_other():
    jobs = [1, 2, -1, 3, 4, 5, -2, 6, 7, 8, 9, 10]
    outcomes = [*in_order(double, jobs, 2)]
    assert outcomes == [Crash() if job < 0 else 2 * job for job in jobs]


def test_a_function_of_a_notebook_will_do():
    offset = 3
    assert [*in_order(lambda job: job + offset, [1, 2, 3], 2)] == [4, 5, 6]


def test_what_a_function_raises_is_raised():
    with pytest.raises(ArithmeticError, match="too much"):
        [*in_order(double, [1, 100, 2], 2)]
    assert [*in_order(double, [1, 2], 2)] == [2, 4]


def test_no_jobs():
    assert [*in_order(double, [], 2)] == []
