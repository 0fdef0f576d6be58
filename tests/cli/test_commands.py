"""`petalfit demo`, `synth`, `parameters`, `--help`, `--version`."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

import petalfit as pf
from petalfit.cli.console import with_error
from petalfit.synthetic import random_petal, read_case
from tests.cli.conftest import Outcome, contents

Call = Callable[..., Outcome]
COMMANDS = ("demo", "fit", "synth", "parameters")
HEAVY = ("jax", "equinox", "optimistix", "lineax", "scipy", "trimesh", "matplotlib", "numpy")


def test_demo(petalfit: Call, tmp_path: Path) -> None:
    outcome = petalfit("demo", "--out", tmp_path / "demo")
    assert outcome.status == 0, outcome.err
    files = "cloud.ply", "truth.json", "fit.json", "fit.glb", "report.html", "picture.png"
    assert contents(tmp_path / "demo").keys() == set(files)
    for file in files:
        assert str(tmp_path / "demo" / file) in outcome.out
    case, (cloud,) = read_case(tmp_path / "demo")
    result = pf.FitResult.load(tmp_path / "demo/fit.json")
    np.testing.assert_array_equal(result.agreements[0].target.points, cloud.points)
    for name in result.names:
        truth = float(getattr(case.model, name))
        assert abs(result.values[name] - truth) < 5 * result.stderr[name], name
        assert f"{truth:.6g}" in outcome.out
    assert outcome.out.count(" σ ") == len(result.names)


def test_demo_options(petalfit: Call, tmp_path: Path, instantly: Callable) -> None:
    instantly()
    out = tmp_path / "demo"
    outcome = petalfit("demo", "--out", out, "--points", 60, "--noise", 0, "--seed", 4, "--quiet")
    assert (outcome.status, outcome.out, outcome.err) == (0, "", "")
    case, (cloud,) = read_case(out)
    assert (len(cloud), case.noise, case.seed) == (60, 0.0, 4)
    assert case.model == random_petal(np.random.default_rng(4))
    for option, value in ("points", 12), ("noise", -1), ("seed", -1):
        outcome = petalfit("demo", "--out", tmp_path / "no", f"--{option}", value)
        assert outcome.status == 2
        assert f"--{option} {value}" in outcome.err
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("suffix", [".ply", ".xyz", ".csv", ".npy", ".npz"])
def test_synth_cloud(petalfit: Call, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"petal{suffix}"
    options = ["--set", "a_x=20", "--set", "dx=-0.25", "--points", 40, "--noise", 0.1, "--seed", 2]
    outcome = petalfit("synth", "-o", path, *options)
    assert outcome.status == 0, outcome.err
    assert "40 points of a peony petal, a_x 20, b_y 22" in outcome.out
    expected = pf.PeonyPetal(a_x=20.0, dx=-0.25).sample(40, seed=2, noise=0.1)
    np.testing.assert_array_equal(pf.PointCloud.load(path).points, expected.points)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".stl"])
def test_synth_mesh(petalfit: Call, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"petal{suffix}"
    outcome = petalfit("synth", "--out", path, "--set", "dy=-4")
    assert outcome.status == 0, outcome.err
    assert contents(tmp_path).keys() == {path.name}, "and no material file beside it"
    mesh, expected = trimesh.load_mesh(path), pf.PeonyPetal(dy=-4.0).mesh()
    assert len(mesh.faces) == len(expected.faces)
    np.testing.assert_allclose(mesh.bounds, expected.bounds, atol=1e-5)
    assert mesh.area == pytest.approx(expected.area, rel=1e-5)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-o", "petal.docx"], "unknown suffix '.docx'; clouds are .ply .xyz .csv .npy .npz"),
        (
            ["-o", "petal.ply", "--set", "width=3"],
            "names no parameter; the parameters are a_x, b_y",
        ),
        (["-o", "petal.ply", "--set", "a_x"], "has no value; write --set a_x=14"),
        (["-o", "petal.ply", "--set", "a_x=wide"], "gives no number"),
        (["-o", "petal.ply", "--set", "a_x=500"], r"outside the range of a_x, which is (1, 100)"),
        (["-o", "petal.ply", "--set", "a_x=nan"], "outside the range of a_x"),
        (["-o", "petal.ply", "--noise", "-1"], "--noise -1 is no standard deviation"),
        (["-o", "petal.ply", "--points", "2"], "--points 2 are too few"),
        (["-o", "petal.ply", "--seed", "-3"], "--seed -3 is negative"),
        (["-o", "petal.glb", "--noise", "0.1"], "is a mesh, which has no --points and no --noise"),
        (["-o", "none/petal.ply"], "cannot be written (No such file or directory)"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_synth_refuses(
    petalfit: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = petalfit("synth", *arguments)
    assert outcome.status == 2
    assert sentence in outcome.err
    assert outcome.err.count("\n") == 1
    assert contents(tmp_path) == {}


def test_parameters_come_from_their_declarations(
    petalfit: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    outcome = petalfit("parameters")
    assert outcome.status == 0
    declared = pf.parameters(pf.PeonyPetal)
    assert len(declared) == 11
    for name, parameter in declared.items():
        row = next(line for line in outcome.out.splitlines() if line.split()[:1] == [name])
        default = float(getattr(pf.PeonyPetal(), name))
        low, high = parameter.bounds
        for text in parameter.symbol, parameter.meaning, f"{default:g}", f"{low:g} to {high:g}":
            assert text in row
        assert ("fixed" in row) == parameter.fixed
    assert petalfit("parameters", "PeonyPetal").out == outcome.out
    refused = petalfit("parameters", "Rosette")
    assert refused.status == 2
    assert "there is no model 'Rosette'; the models are " in refused.err
    for model in ("PeonyPetal", "Pedicel", "Bowl", "Ellipsoid"):
        assert model in refused.err.partition("the models are")[2]
    assert "Posed" not in refused.err


def test_help_and_version(petalfit: Call) -> None:
    whole = petalfit("--help")
    assert whole.status == 0
    assert petalfit() == whole
    for command in COMMANDS:
        assert command in whole.out
        outcome = petalfit(command, "--help")
        assert outcome.status == 0
        assert f"usage: petalfit {command}" in outcome.out
    assert petalfit("--version") == Outcome(0, f"petalfit {pf.__version__}\n", "")


def test_no_help_imports_anything_heavy() -> None:
    program = (
        "import sys; from petalfit.cli import main\n"
        f"statuses = [main([*c, '--help']) for c in ((), *zip({COMMANDS}))]\n"
        f"assert not any(statuses), statuses\n"
        f"found = [name for name in {HEAVY} if name in sys.modules]\n"
        "assert not found, found"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (14.00349, 0.0123, ("14.003", "0.012")),
        (-0.5, 0.0996, ("-0.50", "0.10")),
        (1234.5678, 31.4, ("1235", "31")),
        (1234.5678, 4321.0, ("1235", "4321")),
        (0.123456789, np.inf, ("0.123457", "")),
        (0.1, 0.0, ("0.1", "")),
        (np.nan, np.nan, ("nan", "")),
    ],
)
def test_values_are_rounded_by_their_errors(
    value: float, error: float, shown: tuple[str, str]
) -> None:
    assert with_error(value, error) == shown


def test_no_number_is_cut_off(
    petalfit: Call, tmp_path: Path, instantly: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    instantly()
    monkeypatch.setenv("COLUMNS", "44")
    assert "…" not in petalfit("demo", "--out", tmp_path / "demo").out


def test_closed_pipe_is_no_error() -> None:
    program = f"{sys.executable} -m petalfit parameters | head -n 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", program], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.returncode in {0, 1, 141}
