"""Seconds by stage: an inner stage stops the clock of the outer one."""

from contextlib import suppress

import pytest

from petalfit.compilation import stage, watched
from petalfit.compilation import stopwatch as module


def test_stages_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(module.time, "perf_counter", lambda: now)
    with watched("outer") as watch:
        now = 1.0
        with stage("inner"):
            now = 3.0
            module.moved(0.5, "moved")
        now = 7.0
        with suppress(ValueError), stage("inner"):
            now = 8.0
            raise ValueError
        now = 8.5
    assert watch.seconds == {"outer": 5.5, "inner": 2.5, "moved": 0.5}


def test_nobody_need_watch() -> None:
    with stage("anything"):
        module.moved(1.0, "anything")
