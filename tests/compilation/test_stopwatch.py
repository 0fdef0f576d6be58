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
        now = 7.0
        with suppress(ValueError), stage("inner"):
            now = 8.0
            raise ValueError
        now = 8.5
    assert watch.seconds == {"outer": 5.5, "inner": 3.0}


def test_nobody_need_watch() -> None:
    with stage("anything"):
        pass
