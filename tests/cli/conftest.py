"""The command line without a process, and fits that take no time."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from petalfit.cli import main
from petalfit.fitting import FitResult
from tests.fitted import known_pose


@dataclass(frozen=True)
class Outcome:
    """What a user would have seen."""

    status: int
    out: str
    err: str


@pytest.fixture
def petalfit(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    def call(*arguments: object) -> Outcome:
        status = main([str(argument) for argument in arguments])
        return Outcome(status, *capsys.readouterr())

    return call


@pytest.fixture
def instantly(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lets `fit_petal` return, or raise, what it is told to."""

    def ending(outcome: FitResult | BaseException | None = None) -> None:
        def fit_petal(*_: object, **__: object) -> FitResult:
            if isinstance(outcome, BaseException):
                raise outcome
            return outcome or known_pose()

        monkeypatch.setattr("petalfit.fitting.fit_petal", fit_petal)

    return ending


@pytest.fixture
def cloud_file(tmp_path: Path) -> Path:
    path = tmp_path / "petal.ply"
    known_pose().agreements[0].target.save(path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones included."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
