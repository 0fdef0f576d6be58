"""A batch of files: one row a target, whatever happens on the way."""

import errno
import json
import subprocess
import sys

import numpy as np
import pyarrow.parquet
import pytest

import petalfit as pf
from petalfit.batch import folder as module
from petalfit.batch.folder import Shard, run_batch
from petalfit.batch.items import items_of
from petalfit.batch.records import Task, keep, perform
from petalfit.batch.table import as_table
from petalfit.cli import main

COUNT = 8
ROTTEN = ("empty.xyz", "few.xyz", "sub/not_a_cloud.ply")
OPTIONS = {"model": "Ellipsoid", "pose": "known", "loss": "linear", "noise": None, "seed": 0,
           "free": None}  # fmt: skip


def test_the_table_has_the_traits():
    of_one = {"traits": {"length": 2.5, "area": 3.0}, "trait_stderr": {"length": 0.1, "area": None}}
    row, other = as_table([of_one, {}]).to_pylist()
    assert [row[f"trait_{name}"] for name in ("length", "area")] == [2.5, 3.0]
    assert [row[f"trait_{name}_stderr"] for name in ("length", "area")] == [0.1, None]
    assert other["trait_length"] is None


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    (folder / "sub").mkdir()
    (folder / ".hidden").mkdir()
    for k in range(COUNT):
        cloud = pf.Ellipsoid(1.0 + 0.1 * k, 2.0, 3.0).sample(200, seed=k, noise=0.01)
        cloud.save(folder / ("sub" if k % 2 else ".") / f"scan{k}.xyz")
    (folder / ".hidden" / "scan.xyz").write_text("1 2 3\n")
    (folder / "notes.md").write_text("not a target")
    (folder / "empty.xyz").touch()
    (folder / "few.xyz").write_text("1 2 3\n4 5 6\n")
    (folder / "sub" / "not_a_cloud.ply").write_bytes(b"\x00\x01")
    return folder


@pytest.fixture(scope="module")
def finished(source, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    states = []
    outcome = run_batch(items_of(source, OPTIONS), out, workers=2, progress=states.append)
    return out, outcome, states


def table(out):
    return pyarrow.parquet.read_table(out / "table.parquet").to_pylist()


def test_every_file_has_one_row_and_every_failure_its_reason(source, finished):
    out, outcome, states = finished
    rows = {row["id"]: row for row in table(out)}
    assert len(rows) == len(table(out)) == COUNT + len(ROTTEN) == len(outcome.records)
    for k in range(COUNT):
        row = rows[f"sub/scan{k}.xyz" if k % 2 else f"scan{k}.xyz"]
        assert row["status"] == "converged"
        assert row["r_x"] == pytest.approx(1.0 + 0.1 * k, abs=0.02)
        assert 0 < row["r_x_stderr"] < 0.02
        assert row["data"] == 200
        assert row["seconds"] > 0
        assert np.reshape(row["rotation"], (3, 3)) == pytest.approx(np.eye(3))
        fit = pf.FitResult.load(out / "fits" / row["id"] / "fit.json")
        assert fit.values["r_x"] == row["r_x"]
    for name in ROTTEN:
        assert rows[name]["status"] == "unusable"
        assert len(rows[name]["message"]) > 20
        assert rows[name]["r_x"] is None
        assert not (out / "fits" / name / "fit.json").exists()
    assert states[-1].done == states[-1].total == len(rows)
    assert states[-1].failed == len(ROTTEN)


def test_a_rerun_does_what_is_missing_or_changed(source, finished, tmp_path, monkeypatch):
    out, first, _ = finished
    items = items_of(source, OPTIONS)
    again = run_batch(items, out)
    assert again.fitted == 0
    assert again.records == first.records
    done = []

    def noted(function, jobs, workers):
        done.extend(job.item.id for job in jobs)
        return map(function, jobs)

    monkeypatch.setattr(module, "in_order", noted)
    (out / "fits" / "scan2.xyz" / "record.json").unlink()
    (out / "fits" / "sub" / "scan3.xyz" / "record.json").write_text("{")
    text = (source / "scan4.xyz").read_text()
    (source / "scan4.xyz").write_text(text + "\n")
    crashed = out / "fits" / "empty.xyz" / "record.json"
    crashed.write_text(json.dumps(json.loads(crashed.read_text()) | {"status": "crashed"}))
    try:
        assert run_batch(items, out).fitted == 4
    finally:
        (source / "scan4.xyz").write_text(text)
    assert done == ["empty.xyz", "scan2.xyz", "scan4.xyz", "sub/scan3.xyz"]
    assert len(table(out)) == COUNT + len(ROTTEN)
    # Other options are another fit.
    other = items_of(source, OPTIONS | {"seed": 1})
    done.clear()
    run_batch(other[:1], tmp_path)
    run_batch(items[:1], tmp_path)
    assert done == [items[0].id, items[0].id]


def test_shards_complete_one_table(source, finished, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "in_order", lambda function, jobs, workers: map(function, jobs))
    items = items_of(source, OPTIONS)
    missing = [run_batch(items, tmp_path, shard=Shard(k, 3)).missing for k in (1, 2, 3)]
    assert missing == [7, 3, 0]
    ids = [row["id"] for row in table(tmp_path)]
    assert ids == [item.id for item in items]


def test_a_worker_that_dies_and_a_full_disk(source, tmp_path, monkeypatch):
    items = items_of(source, OPTIONS)
    monkeypatch.setattr(
        module, "in_order", lambda function, jobs, workers: (module.Crash() for _ in jobs)
    )
    outcome = run_batch(items[:1], tmp_path)
    assert outcome.records[0]["status"] == "crashed"
    assert table(tmp_path)[0]["status"] == "crashed"
    monkeypatch.setattr(module, "in_order", lambda function, jobs, workers: map(function, jobs))

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("petalfit.fitting.FitResult.save", full)
    with pytest.raises(pf.TargetError, match="make room"):
        run_batch(items, tmp_path)
    monkeypatch.undo()
    record = perform(Task(items[2], tmp_path / "fits" / items[2].id, None))
    assert record["status"] == "converged"


def test_a_place_that_cannot_be_written_is_a_status(source, tmp_path):
    (tmp_path / "file").touch()
    item = items_of(source, OPTIONS)[0]
    record = keep(
        Task(item, tmp_path / "file" / "below", None),
        pf.FitFailure(pf.Status.UNUSABLE, "x"),
        "",
        0.0,
    )
    assert record["status"] == "not_written"
    assert not record["disk_full"]


def test_manifest(source, tmp_path):
    cloud, camera = (
        pf.PeonyPetal().sample(50),
        pf.Camera.orthographic(np.diag([1.0, -1.0, -1.0]), 3.0, (32.0, 32.0), (64, 64)),
    )
    cloud.save(tmp_path / "a.ply")
    (tmp_path / "camera.json").write_text(json.dumps(camera.to_json()))
    manifest = tmp_path / "list.csv"
    manifest.write_text(
        "target,id,model,camera,free,noise\n"
        "a.ply,first,BladePetal,,,0.5\n"
        'a.ply; m.png,,,camera.json,"a_x b_y",\n'
    )
    first, second = items_of(manifest, OPTIONS)
    assert (first.id, first.options["model"], first.options["noise"]) == (
        "first",
        "BladePetal",
        0.5,
    )
    assert second.id == "a.ply+ m.png"
    assert second.targets == (tmp_path / "a.ply", tmp_path / "m.png")
    assert second.cameras == (tmp_path / "camera.json",)
    assert second.options["free"] == ["a_x", "b_y"]
    assert second.options["model"] == "Ellipsoid"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("file\na.ply\n", "no column 'target'"),
        ("target,nosie\na.ply,1\n", "nosie"),
        ("target\n", "no rows"),
        ("target,noise\na.ply,big\n", "line 2"),
        ("target,model\na.ply,Tulip\n", "Tulip"),
        ("target\na.ply\na.ply\n", "same id"),
        ("target,id\n,x\n", "no target"),
    ],
)
def test_manifests_that_cannot_be_followed(tmp_path, text, words):
    (tmp_path / "list.csv").write_text(text)
    with pytest.raises(pf.TargetError, match=words):
        items_of(tmp_path / "list.csv", OPTIONS)


def test_no_id_leaves_the_output(tmp_path):
    (tmp_path / "list.csv").write_text("target,id\na.ply,../../x\n/b.ply,\n")
    assert [item.id for item in items_of(tmp_path / "list.csv", OPTIONS)] == ["x", "b.ply"]


def test_command(source, finished, capsys):
    out, _, _ = finished
    command = ["batch", str(source), "--out", str(out), "--model", "Ellipsoid", "--profile"]
    main(command)
    capsys.readouterr()
    status = main(command)
    text = capsys.readouterr().out
    assert status == 3
    assert "0 of them fitted now" in text
    assert "3 unusable" in text
    assert "polishing" in text
    assert main(["batch", str(source / "none"), "--out", str(out)]) == 2
    assert main(["batch", str(source), "--out", str(out), "--shard", "4/3"]) == 2
    assert main(["batch", str(source / "notes.md"), "--out", str(out)]) == 2
    assert "manifest" in capsys.readouterr().err


# The command with Ctrl-C after its third target, as a terminal sends it: to every process.
INTERRUPTED = """
import os, signal, sys
from petalfit.batch import folder
from petalfit.cli import main

def three(*arguments, every=folder.as_finished):
    for count, done in enumerate(every(*arguments), 1):
        yield done
        if count == 3:
            os.killpg(0, signal.SIGINT)

folder.as_finished = three
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background ignores
sys.exit(main(sys.argv[1:]))
"""


def test_interrupted_killed_and_resumed_on_a_cluster(source, tmp_path):
    """Ctrl-C, the death of every worker, and the same command again: every target has one row."""
    command = ["batch", str(source), "--out", str(tmp_path), "--model", "Ellipsoid",
               "--scheduler", "local", "--workers", "2"]  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, *command],
        start_new_session=True,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 130, run.stderr
    assert "the same command goes on" in run.stderr
    assert 3 <= len(table(tmp_path)) == len([*tmp_path.rglob("record.json")])
    again = subprocess.run(
        [sys.executable, "-m", "petalfit", *command], capture_output=True, text=True
    )
    assert again.returncode == 3, again.stderr
    assert f"{COUNT + len(ROTTEN)} targets" in again.stdout
    ids = [row["id"] for row in table(tmp_path)]
    assert len(ids) == len(set(ids)) == COUNT + len(ROTTEN)
