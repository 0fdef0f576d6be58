"""What cannot be used: status 2, one sentence, and nothing written."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from petalfit.observations import PointCloud
from tests.cli.conftest import Outcome, contents
from tests.fitted import known_pose

Call = Callable[..., Outcome]
GRID = np.stack(np.meshgrid(range(-5, 6), range(11), [0.0]), axis=-1).reshape(-1, 3).astype(float)
LINE = np.outer(np.linspace(0.0, 20.0, 50), [1.0, 2.0, 0.5])


def file_with(points: object) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        np.save(folder / "cloud.npy", np.asarray(points))
        return folder / "cloud.npy"

    return make


def file_of(name: str, content: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


TARGETS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing": (lambda folder: folder / "none.ply", "there is no such file"),
    "folder": (lambda folder: folder, "is a folder"),
    "garbage": (file_of("cloud.ply", b"\x93garbage \x00\xff" * 99), "is no PLY file"),
    "garbage-npz": (file_of("cloud.npz", b"PK\x03\x04 no archive"), "is damaged, cut short or no"),
    "suffix": (file_of("cloud.docx", b"points"), "unknown suffix '.docx'"),
    "empty": (file_of("cloud.csv", b""), "is empty"),
    "no-rows": (file_of("cloud.csv", b"x,y,z\n"), "no"),
    "words": (file_of("cloud.csv", b"x,y,z\none,two,three\n"), "one"),
    "nan": (file_with(np.full((50, 3), np.nan)), "all 50 are NaN or infinite"),
    "few-finite": (file_with([[0, 0, 0], [0, np.inf, 0], [1, 0, 0]]), "all lie on one line"),
    "shape": (file_with(GRID[:, :2]), r"shape \(121, 2\), expected \(N, 3\)"),
    "few": (file_with(GRID[[0, 7, 13, 40, 77]]), "5 points cannot determine 10 free parameters"),
    "equal": (file_with(np.ones((50, 3))), "points all coincide"),
    "collinear": (file_with(LINE), "points all lie on one line"),
    "large": (file_with(1e6 * GRID), "bring the target to the model's unit"),
    "far": (file_with(GRID + 1e6), "near its origin"),
    "small": (file_with(1e-3 * GRID), "bring it to the model's unit"),
}


@pytest.mark.parametrize(("make", "sentence"), TARGETS.values(), ids=TARGETS)
def test_target(
    petalfit: Call, tmp_path: Path, make: Callable[[Path], Path], sentence: str
) -> None:
    target = make(tmp_path)
    refused(petalfit, tmp_path, sentence, target)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--free", "a_x", "--free", "width"], "free names 'width'; the parameters of PeonyPetal"),
        (["--free", ","], "free names no parameter"),
        (["--noise", "0"], "--noise 0 is no standard deviation"),
        (["--noise", "nan"], "--noise nan is no standard deviation"),
        (["--seed", "-1"], "--seed -1 is negative"),
        (["--init", "none.json"], "none.json cannot be read as a fit result"),
    ],
)
def test_options(petalfit: Call, tmp_path: Path, options: list[str], sentence: str) -> None:
    refused(petalfit, tmp_path, sentence, file_with(GRID)(tmp_path), *options)


def _without(*names: str) -> Callable[[dict], object]:
    return lambda content: {key: value for key, value in content.items() if key not in names}


INITS: dict[str, tuple[Callable[[dict], object], str]] = {
    "garbage": (lambda content: "{", "cannot be read as a fit result"),
    "list": (lambda content: [1, 2], "cannot be read as a fit result: expected an object"),
    "format": (_without("format"), "is not a fit result"),
    "version": (lambda content: content | {"version": 99}, "has version 99 of the format"),
    "missing": (_without("values"), "is a damaged fit result: .*values"),
    "words": (
        lambda content: content | {"values": content["values"] | {"a_x": "wide"}},
        "is a damaged fit result",
    ),
    "outside": (
        lambda content: content | {"values": content["values"] | {"a_x": 250.0}},
        r"a_x is 250, outside of its range \(1, 100\)",
    ),
}


@pytest.mark.parametrize(("change", "sentence"), INITS.values(), ids=INITS)
def test_init(
    petalfit: Call,
    tmp_path: Path,
    change: Callable[[dict], object],
    sentence: str,
) -> None:
    known_pose().save(tmp_path / "init.json")
    changed = change(json.loads((tmp_path / "init.json").read_text()))
    text = changed if isinstance(changed, str) else json.dumps(changed)
    (tmp_path / "init.json").write_text(text)
    target = file_with(GRID)(tmp_path)
    refused(petalfit, tmp_path, sentence, target, "--init", tmp_path / "init.json")


def refused(petalfit: Call, tmp_path: Path, sentence: str, *arguments: object) -> None:
    before = contents(tmp_path)
    outcome = petalfit("fit", *arguments, "--out", tmp_path / "out")
    assert outcome.status == 2
    assert outcome.out == ""
    assert outcome.err.startswith("petalfit: ")
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.err
    assert re.search(sentence, outcome.err)
    assert contents(tmp_path) == before
    assert not (tmp_path / "out").exists()


def test_places_that_cannot_be_written_to(
    petalfit: Call, tmp_path: Path, cloud_file: Path, instantly: Callable
) -> None:
    instantly()
    before = contents(tmp_path)
    for out in cloud_file, cloud_file / "below":
        outcome = petalfit("fit", cloud_file, "--out", out)
        assert outcome.status == 2
        assert "petal.ply is not a folder; choose another --out" in outcome.err
    (tmp_path / "out/fit.glb").mkdir(parents=True)
    outcome = petalfit("fit", cloud_file, "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "fit.glb is a folder; choose another --out" in outcome.err
    assert contents(tmp_path) == before


def test_full_disk(
    petalfit: Call,
    tmp_path: Path,
    cloud_file: Path,
    instantly: Callable,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    instantly()
    monkeypatch.setattr("petalfit.report.write_report", full)
    before = contents(tmp_path)
    outcome = petalfit("fit", cloud_file, "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "cannot be written (No space left on device); nothing was." in outcome.err
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "arguments",
    [["fit"], ["fit", "a.ply"], ["fit", "a.ply", "--out"], ["fit", "a.ply", "--oot", "b"], ["fti"]],
    ids=" ".join,
)
def test_command_line_that_is_not_understood(petalfit: Call, arguments: list[str]) -> None:
    outcome = petalfit(*arguments)
    assert outcome.status == 2
    assert outcome.out == ""
    assert "--help" in outcome.err


def test_our_own_bugs_are_not_called_bad_input(
    petalfit: Call, tmp_path: Path, cloud_file: Path, instantly: Callable
) -> None:
    instantly(ValueError("operands could not be broadcast"))
    with pytest.raises(ValueError, match="broadcast"):
        petalfit("fit", cloud_file, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_weights_leave_too_few(petalfit: Call, tmp_path: Path) -> None:
    weights = np.zeros(len(GRID))
    weights[[0, 5, 60, 90]] = 1.0
    PointCloud(GRID, weights=weights).save(tmp_path / "cloud.npz")
    refused(petalfit, tmp_path, "4 points cannot determine", tmp_path / "cloud.npz")
