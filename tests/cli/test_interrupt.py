"""Ctrl-C: status 130, one line, and the folder is as it was."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from petalfit.fitting import FitResult
from tests.cli.conftest import Outcome, contents
from tests.fitted import known_pose

Call = Callable[..., Outcome]
MESSAGE = "petalfit: interrupted; nothing was written\n"


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """What a shell starts in the background ignores Ctrl-C, these tests included."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(params=["new", "older"])
def out(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A folder that does not exist, or holds an older result."""
    if request.param == "older":
        (tmp_path / "out").mkdir()
        for name in "fit.json", "report.html", "notes.txt":
            (tmp_path / "out" / name).write_text(f"older {name}")
    return tmp_path / "out"


def interrupted(petalfit: Call, cloud_file: Path, out: Path) -> None:
    before, entries = contents(out.parent), sorted(os.listdir(out.parent))
    outcome = petalfit("fit", cloud_file, "--out", out)
    assert outcome == Outcome(130, "", MESSAGE)
    assert contents(out.parent) == before
    assert sorted(os.listdir(out.parent)) == entries


def test_during_the_fit(petalfit: Call, cloud_file: Path, out: Path, instantly: Callable) -> None:
    instantly(KeyboardInterrupt())
    interrupted(petalfit, cloud_file, out)


def test_while_writing(
    petalfit: Call,
    cloud_file: Path,
    out: Path,
    instantly: Callable,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def half(result: FitResult, path: Path) -> None:
        path.write_text("<html>")
        raise KeyboardInterrupt

    instantly()
    monkeypatch.setattr("petalfit.report.write_report", half)
    interrupted(petalfit, cloud_file, out)


@pytest.mark.parametrize("step", range(6))
@pytest.mark.parametrize("late", [False, True], ids=["before", "after"])
def test_while_moving(
    petalfit: Call,
    cloud_file: Path,
    out: Path,
    instantly: Callable,
    monkeypatch: pytest.MonkeyPatch,
    step: int,
    late: bool,
) -> None:
    replace, count = os.replace, 0

    def interrupting(source: Path, target: Path) -> None:
        nonlocal count
        # Other renames are those of the files' own writers.
        moving = Path(source).parent != Path(target).parent
        count += moving
        hit = moving and count == step + 1
        if hit and not late:
            raise KeyboardInterrupt
        replace(source, target)
        if hit:
            raise KeyboardInterrupt

    instantly()
    monkeypatch.setattr("petalfit.report.write_report", lambda _, path: path.write_text("new"))
    monkeypatch.setattr("os.replace", interrupting)
    if not out.exists() or step >= 5:
        # A new folder is one rename; two older files and three new ones are five.
        assert petalfit("fit", cloud_file, "--out", out).status == 0
    else:
        interrupted(petalfit, cloud_file, out)


def test_is_heard_though_a_library_swallows_it(
    petalfit: Call,
    cloud_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def deaf(*_: object, **__: object) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException:  # as around trimesh's optional imports
            time.sleep(600.0)  # until it is heard
        raise AssertionError("nobody heard it")

    monkeypatch.setattr("petalfit.fitting.fit_petal", deaf)
    interrupted(petalfit, cloud_file, tmp_path / "out")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ignored_signals_stay_ignored(
    petalfit: Call, cloud_file: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    def fit_petal(*_: object, **__: object) -> FitResult:
        signal.raise_signal(signal.SIGINT)
        return known_pose()

    monkeypatch.setattr("petalfit.fitting.fit_petal", fit_petal)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert petalfit("fit", cloud_file, "--out", tmp_path / "out").status == 0
    finally:
        signal.signal(signal.SIGINT, before)
