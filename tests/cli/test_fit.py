"""`petalfit fit`: files, table, warnings and exit statuses."""

import dataclasses
import html
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from petalfit import FitWarning, Status, WarningKind, __version__
from petalfit.fitting import FitResult
from petalfit.observations import PointCloud
from petalfit.synthetic import Case, make, random_petal
from tests.cli.conftest import Outcome, contents
from tests.fitted import changed, known_pose

FILES = {"fit.json", "fit.glb", "report.html"}
Call = Callable[..., Outcome]
CASE = Case("cli", "of these tests", random_petal(np.random.default_rng(3)), 1500, 0.05, 3)


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    return make(CASE)


def test_fit_from_nothing(petalfit: Call, cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "petal.npz")
    outcome = petalfit("fit", tmp_path / "petal.npz", "--out", tmp_path / "some/where")
    assert (outcome.status, outcome.err) == (0, "")
    found = contents(tmp_path / "some/where")
    assert found.keys() == FILES
    assert all(found.values())
    assert not list(tmp_path.rglob(".petalfit*"))
    result = FitResult.load(tmp_path / "some/where/fit.json")
    for name in result.names:
        truth = float(getattr(CASE.model, name))
        assert abs(result.values[name] - truth) < 6 * result.stderr[name], name
        assert name in outcome.out
    assert "fixed" in outcome.out
    for name in result.traits:
        assert name in outcome.out
    summary = f"1,500 points, rms distance {result.rms:.3g}, noise {result.noise:.3g} (estimated); "
    assert summary + "converged after" in outcome.out
    for file in FILES:
        assert str(Path("where") / file) in outcome.out.replace("\n", "")


def test_results_say_what_made_them(petalfit: Call, instantly, cloud_file: Path) -> None:
    instantly()
    folder = cloud_file.parent
    out = folder / "a & b"
    assert petalfit("fit", cloud_file, "--out", out, "--noise", 0.05).status == 0
    command = f"petalfit fit {cloud_file} --out '{out}' --noise 0.05"
    saved = FitResult.load(out / "fit.json")
    assert saved.command == command
    assert saved.made_by == f"petalfit {__version__}"
    page = (out / "report.html").read_text(encoding="utf-8")
    assert html.escape(command) in page
    assert saved.input_hash in page
    saved.report(folder / "again.html")
    assert (folder / "again.html").read_text(encoding="utf-8") == page
    assert not known_pose().command


def test_init_and_noise(petalfit: Call, cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "petal.csv")
    with (tmp_path / "petal.csv").open("a") as file:
        file.write("nan,nan,nan\n")
    values = {name: float(value) for name, value in vars(CASE.model).items()}
    before = dataclasses.replace(known_pose(), model=CASE.model, values=values)
    before.save(tmp_path / "before.json")
    options = ["--init", tmp_path / "before.json", "--noise", 0.06]
    outcome = petalfit("fit", tmp_path / "petal.csv", "--out", tmp_path / "out", *options)
    assert outcome.status == 0, outcome.err
    result = FitResult.load(tmp_path / "out/fit.json")
    assert [start.label for start in result.starts] == ["given"]
    assert result.noise == 0.06
    assert "noise 0.06 (given)" in outcome.out
    # What was noted when the file was read is the first of the warnings, everywhere.
    note = "1 of 1,501 points are NaN or infinite, and were left out"
    assert (result.warnings[0], result.warnings[0].kind) == (note, WarningKind.TARGET)
    assert f"warning: {note}" in outcome.err
    assert note in (tmp_path / "out/report.html").read_text(encoding="utf-8")


def test_quiet_says_nothing(
    petalfit: Call, cloud_file: Path, tmp_path: Path, instantly: Callable
) -> None:
    instantly()
    assert petalfit("fit", cloud_file, "--out", tmp_path / "out", "--quiet") == Outcome(0, "", "")
    assert contents(tmp_path / "out").keys() == FILES


def test_options_reach_the_fit(
    petalfit: Call,
    cloud_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    received = {}

    def fit_petal(target: PointCloud, **options: object) -> FitResult:
        received.update(options, target=target)
        return known_pose()

    monkeypatch.setattr("petalfit.fitting.fit_petal", fit_petal)
    options = ["--free", "a_x", "--free", "b_y, c", "--seed", 5, "--noise", 0.1]
    petalfit("fit", cloud_file, "--out", tmp_path, *options)
    assert received["free"] == ["a_x", "b_y", "c"]
    assert (received["seed"], received["noise"], received["init"]) == (5, 0.1, None)
    assert received["throw"] is False
    np.testing.assert_array_equal(
        received["target"].points, known_pose().agreements[0].target.points
    )
    petalfit("fit", cloud_file, "--out", tmp_path)
    assert (received["free"], received["noise"], received["seed"]) == (None, None, 0)


def test_undetermined_parameters_and_warnings_are_told(
    petalfit: Call, cloud_file: Path, tmp_path: Path, instantly: Callable
) -> None:
    fitted = known_pose()
    # Text in brackets must not be taken for rich's markup.
    warnings = (
        FitWarning("dx is not determined by this target", "not_determined", ["dx"]),
        FitWarning("something in [brackets]", "systematic"),
    )
    covariance = fitted.covariance.copy()
    row = fitted.names.index("dx")
    covariance[row, :] = covariance[:, row] = math.inf
    instantly(
        dataclasses.replace(
            fitted,
            stderr=fitted.stderr | {"dx": math.inf},
            identifiable=fitted.identifiable | {"dx": False},
            covariance=covariance,
            warnings=warnings,
        )
    )
    for quiet in [], ["--quiet"]:
        outcome = petalfit("fit", cloud_file, "--out", tmp_path / "out", *quiet)
        assert outcome.status == 0
        assert outcome.err == "".join(f"warning: {text}\n" for text in reversed(warnings))
        assert ("not determined" in outcome.out) == (not quiet)


def test_not_converged_is_status_3_and_files_are_there(
    petalfit: Call, cloud_file: Path, tmp_path: Path, instantly: Callable
) -> None:
    fitted = known_pose()
    instantly(
        dataclasses.replace(
            fitted,
            status=Status.MISFIT,
            warnings=(FitWarning("dx is not determined", "not_determined", ["dx"]),),
            reason="no petal; either this, or that",
        )
    )
    outcome = petalfit("fit", cloud_file, "--out", tmp_path / "out")
    assert outcome.status == 3
    assert outcome.err == (
        "petalfit: no petal; either this, or that; the files hold what it ended with\n"
        "warning: dx is not determined\n"
    )
    assert contents(tmp_path / "out").keys() == FILES
    assert not json.loads((tmp_path / "out/fit.json").read_text())["converged"]


def test_a_fit_without_a_result_is_told_too(
    petalfit: Call, cloud_file: Path, tmp_path: Path, instantly: Callable
) -> None:
    fitted = known_pose()
    nothing = np.full_like(fitted.distances, np.nan)
    size = len(fitted.names)
    instantly(
        changed(
            fitted,
            stderr=dict.fromkeys(fitted.names, math.inf),
            identifiable=dict.fromkeys(fitted.names, False),
            covariance=np.full((size, size), math.inf),
            noise=math.nan,
            distances=nothing,
            status=Status.NOT_FINITE,
            reason="the solver met values that are not finite",
        )
    )
    outcome = petalfit("fit", cloud_file, "--out", tmp_path / "out")
    assert outcome.status == 3
    assert "not finite" in outcome.err
    assert contents(tmp_path / "out").keys() == FILES


def test_older_files_are_replaced_and_others_kept(
    petalfit: Call, cloud_file: Path, tmp_path: Path, instantly: Callable
) -> None:
    instantly()
    out = tmp_path / "out"
    out.mkdir()
    (out / "fit.json").write_text("older")
    (out / "notes.txt").write_text("mine")
    assert petalfit("fit", cloud_file, "--out", out).status == 0
    assert contents(out).keys() == FILES | {"notes.txt"}
    assert (out / "notes.txt").read_text() == "mine"
    FitResult.load(out / "fit.json")


def test_wrong_frame_is_not_silent(petalfit: Call, cloud: PointCloud, tmp_path: Path) -> None:
    # Lying on its side, the petal is nothing that the model can be in its own frame.
    PointCloud(cloud.points[:, [2, 0, 1]]).save(tmp_path / "turned.npy")
    outcome = petalfit("fit", tmp_path / "turned.npy", "--out", tmp_path / "out")
    assert outcome.status == 3
    assert "not in the model's frame" in outcome.err
    assert contents(tmp_path / "out").keys() == FILES
