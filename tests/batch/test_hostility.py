"""What happens to a batch on the way: nothing is lost or doubled, and it is said in words."""

import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

import petalfit as pf
from petalfit.batch import cluster, records
from petalfit.batch import folder as module
from petalfit.batch.failure import FitFailure
from petalfit.batch.folder import Shard, run_batch
from petalfit.batch.items import Item, items_of
from petalfit.batch.lock import locked
from petalfit.batch.processes import in_order
from petalfit.batch.records import Task, keep, perform, read_record
from petalfit.batch.table import as_table
from petalfit.cli import main
from petalfit.schema import SchemaError
from tests.fitted import known_pose
from tests.mutations import damaged, each_case

OPTIONS = {"model": "PeonyPetal", "pose": "known", "loss": "linear", "noise": None, "seed": 0,
           "free": None}  # fmt: skip


@pytest.fixture
def source(tmp_path):
    folder = tmp_path / "scans"
    folder.mkdir()
    for name in ("a", "b", "c"):
        pf.PeonyPetal().sample(50, seed=1).save(folder / f"{name}.xyz")
    return folder


@pytest.fixture
def stub(monkeypatch):
    """Fits that cost nothing: every target gets a failure, in this process. Returns the ids fitted."""
    done = []

    def fitted(task: Task):
        done.append(task.item.id)
        return keep(task, FitFailure(pf.Status.UNUSABLE, "a stub"), task.item.digest(), 0.1)

    monkeypatch.setattr(module, "in_order", lambda _, jobs, workers: map(fitted, jobs))
    return done


def table(out):
    return pyarrow.parquet.read_table(out / "table.parquet").to_pylist()


def task_of(tmp_path) -> Task:
    (tmp_path / "a.xyz").write_text("1 2 3\n")
    return Task(Item("a.xyz", (tmp_path / "a.xyz",), (), OPTIONS), tmp_path / "fits/a.xyz", None)


def record_of(tmp_path) -> bytes:
    task = task_of(tmp_path)
    keep(task, known_pose(), "", 1.0)
    return (task.folder / "record.json").read_bytes()


def attempt(content: bytes, tmp_path) -> None:
    """A record is refused, or a row of the table."""
    task = task_of(tmp_path)
    task.folder.mkdir(parents=True, exist_ok=True)
    (task.folder / "record.json").write_bytes(content)
    try:
        record = read_record(task)
    except SchemaError as error:
        said = str(error)
    else:
        assert record is not None
        pyarrow.parquet.write_table(as_table([record]), io.BytesIO())
        return
    assert "record.json is damaged" in said


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> bytes:
    return record_of(tmp_path_factory.mktemp("record"))


@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_record_is_refused_or_a_row(seed, record, tmp_path):
    attempt(damaged(record, seed), tmp_path)


@pytest.mark.slow
def test_many_damaged_records_are_refused_or_rows(record, tmp_path):
    for seed in range(100, 2100):
        attempt(damaged(record, seed), tmp_path)


@each_case("record*")
def test_records_that_were_seen_to_break(path, tmp_path):
    attempt(path.read_bytes(), tmp_path)


def test_a_record_survives_its_file(tmp_path):
    task = task_of(tmp_path)
    assert read_record(task) is None
    written = keep(task, known_pose(), "", 1.0)
    assert read_record(task) == written
    keep(task, FitFailure(pf.Status.CRASHED, "it died"), "", float("nan"))
    again = read_record(task)
    assert again is not None
    assert np.isnan(again["seconds"])


def test_damaged_records_are_fitted_again_or_left_out(source, tmp_path, stub, capsys):
    items, out = items_of(source, OPTIONS), tmp_path / "out"
    run_batch(items, out)
    assert stub == ["a.xyz", "b.xyz", "c.xyz"]
    for name in ("a", "b"):
        path = out / "fits" / f"{name}.xyz" / "record.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"values": 1e7}))
    outcome = run_batch(items, out, shard=Shard(1, 2))  # a and c; b is that of another shard
    assert stub[3:] == ["a.xyz"]
    first, second = outcome.damaged
    assert "a.xyz/record.json is damaged (in values, expected an object" in first
    assert first.endswith("its target is fitted again")
    assert second.endswith("it is not in the table")
    assert [row["id"] for row in table(out)] == ["a.xyz", "c.xyz"]
    assert outcome.missing == 1
    assert main(["batch", str(source), "--out", str(out), "--model", "PeonyPetal"]) == 3
    assert "b.xyz/record.json is damaged" in capsys.readouterr().err
    assert [row["id"] for row in table(out)] == ["a.xyz", "b.xyz", "c.xyz"]


def test_a_record_of_another_target_is_no_record(source, tmp_path, stub):
    items, out = items_of(source, OPTIONS), tmp_path / "out"
    run_batch(items, out)
    copied = (out / "fits/a.xyz/record.json").read_bytes()
    (out / "fits/b.xyz/record.json").write_bytes(copied)
    run_batch(items, out)
    assert stub[3:] == ["b.xyz"]
    assert [row["id"] for row in table(out)] == ["a.xyz", "b.xyz", "c.xyz"]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_names_that_are_not_unicode_are_rows_too(tmp_path, stub):
    folder = tmp_path / "scans"
    folder.mkdir()
    with open(os.fsencode(folder) + b"/\xff.xyz", "wb") as file:
        file.write(b"1 2 3\n")
    for _ in range(2):
        outcome = run_batch(items_of(folder, OPTIONS), tmp_path / "out")
    assert [row["id"] for row in table(tmp_path / "out")] == ["\\udcff.xyz"]
    assert outcome.fitted == 0


HOLDER = """
import sys, time
from pathlib import Path
from petalfit.batch.lock import locked

with locked(Path(sys.argv[1]), (int(sys.argv[2]), int(sys.argv[3]))):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    """Starts a process that holds the folder for a shard, and kills it at the end."""
    started = []

    def hold(number: int, count: int) -> subprocess.Popen:
        command = [sys.executable, "-c", HOLDER, str(tmp_path), str(number), str(count)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        return process

    yield hold
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no locks")
def test_two_batches_do_not_fit_into_one_folder(source, tmp_path, stub, holder):
    other = holder(1, 1)
    for shard in (Shard(1, 1), Shard(1, 2)):
        with pytest.raises(pf.TargetError, match=rf"in use: process {other.pid} on .*Wait until"):
            run_batch(items_of(source, OPTIONS), tmp_path, shard=shard)
    assert stub == []
    # A lock is never stale: the system drops it with its process.
    other.send_signal(signal.SIGKILL)
    other.wait()
    run_batch(items_of(source, OPTIONS), tmp_path)
    assert stub == ["a.xyz", "b.xyz", "c.xyz"]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no locks")
def test_shards_work_side_by_side_and_each_once(tmp_path, holder):
    holder(1, 2)
    with locked(tmp_path, (2, 2)):
        pass
    for shard in ((1, 2), (1, 1)):
        with pytest.raises(pf.TargetError, match="in use"), locked(tmp_path, shard):
            pass


def test_a_file_that_changes_while_it_is_read_is_fitted_again(source, tmp_path, monkeypatch):
    item = items_of(source, OPTIONS)[0]
    task, read = Task(item, tmp_path / "fits", None), Item.read

    def meddled(self: Item):
        found = read(self)
        self.targets[0].write_text(self.targets[0].read_text() + "1 2 3\n")
        return found

    monkeypatch.setattr(Item, "read", meddled)
    record = perform(task)
    assert record["status"] == "unusable"
    assert "changed while it was read" in record["message"]
    assert records.finished(task) is None


def test_a_fit_whose_file_is_gone_is_fitted_again(tmp_path):
    task = task_of(tmp_path)
    keep(task, known_pose(), task.item.digest(), 1.0)
    assert records.finished(task) is not None
    (task.folder / "fit.json").unlink()
    assert records.finished(task) is None


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 1 byte")]
)
def test_a_target_that_needs_too_much_memory_is_tried_again(tmp_path, monkeypatch, error):
    def fails(**_):
        raise error

    monkeypatch.setattr(records, "fit", fails)
    pf.PeonyPetal().sample(50).save(tmp_path / "a.ply")
    item = Item("a.ply", (tmp_path / "a.ply",), (), OPTIONS)
    task = Task(item, tmp_path / "fits", None)
    record = perform(task)
    assert record["status"] == "crashed"
    assert "not enough memory" in record["message"]
    assert records.finished(task) is None


def test_a_result_that_cannot_be_described_is_a_failure_and_no_end(source, tmp_path, monkeypatch):
    monkeypatch.setattr(records, "fit", lambda **_: known_pose())

    def fails(*_):
        raise ZeroDivisionError("traits")

    monkeypatch.setattr("petalfit.results.record.traits_of", fails)
    known_pose().__dict__.pop("traits", None)
    record = perform(Task(items_of(source, OPTIONS)[0], tmp_path / "fits", None))
    assert (record["status"], record["message"]) == ("error", "ZeroDivisionError: traits")


def kills_the_second(task: Task):
    if task.item.id == "b.xyz":
        os.kill(os.getpid(), signal.SIGKILL)
    return keep(task, FitFailure(pf.Status.UNUSABLE, "a stub"), task.item.digest(), 0.1)


def test_a_killed_worker_costs_one_row(source, tmp_path, monkeypatch):
    monkeypatch.setattr(
        module, "in_order", lambda _, jobs, workers: in_order(kills_the_second, jobs, workers)
    )
    run_batch(items_of(source, OPTIONS), tmp_path, workers=2)
    rows = table(tmp_path)
    assert [(row["id"], row["status"]) for row in rows] == [
        ("a.xyz", "unusable"), ("b.xyz", "crashed"), ("c.xyz", "unusable"),
    ]  # fmt: skip


def test_a_scheduler_that_does_not_answer_is_named(source, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT", 1.0)
    with socket.socket() as deaf, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of distributed, on the connection that it gives up
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        address = f"tcp://127.0.0.1:{deaf.getsockname()[1]}"
        with pytest.raises(pf.TargetError, match=rf"no Dask scheduler answers at {address}"):
            run_batch(items_of(source, OPTIONS), tmp_path, scheduler=address)
    assert table(tmp_path) == []


def test_a_scheduler_that_goes_away_is_named(monkeypatch):
    import distributed

    class Gone:
        status = "cancelled"

    class Client:
        def map(self, function, jobs, pure):
            return [Gone() for _ in jobs]

    monkeypatch.setattr(distributed, "as_completed", lambda futures, raise_errors: iter(futures))
    with pytest.raises(pf.TargetError, match="the Dask scheduler has gone"):
        [*cluster.as_finished(Client(), print, [1, 2])]


def test_a_clock_that_goes_back_changes_nothing(source, tmp_path, stub, monkeypatch):
    items = items_of(source, OPTIONS)
    run_batch(items, tmp_path)
    monkeypatch.setattr(time, "time", lambda: 0.0)
    for item in items:
        os.utime(item.targets[0], (0, 0))
        os.utime(tmp_path / "fits" / item.id / "record.json", (0, 0))
    assert run_batch(items, tmp_path).fitted == 0
    assert len(stub) == 3


MANIFEST = (
    b"id,target,camera,model,pose,loss,noise,free,seed\n"
    b"a,a.xyz,,PeonyPetal,known,linear,0.1,a_x,1\n"
)


def follow(content: bytes, folder: Path) -> None:
    (folder / "list.csv").write_bytes(content)
    try:
        items = items_of(folder / "list.csv", OPTIONS)
    except pf.TargetError:
        return
    for item in items:
        record = keep(Task(item, folder / "fits", None), FitFailure.of(ValueError()), "", 0.0)
        assert read_record(Task(item, folder / "fits", None)) == record


@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_manifest_is_refused_or_followed(seed, tmp_path):
    follow(damaged(MANIFEST, seed), tmp_path)


@pytest.mark.slow
def test_many_damaged_manifests_are_refused_or_followed(tmp_path):
    for seed in range(100, 2100):
        follow(damaged(MANIFEST, seed), tmp_path)


@each_case("manifest*")
def test_manifests_that_were_seen_to_break(path, tmp_path):
    follow(path.read_bytes(), tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("target,noise\na.ply,nan\n", "line 2: the noise nan is no standard deviation"),
        ("target,seed\na.ply,-1\n", "line 2: the seed -1 is out of range"),
        ("target,id\na.ply,x\nb.ply,./x\n", "lines 2 and 3 have the same id 'x'"),
        ("target\na\x7f.ply\n", "line 2: the column 'target' has characters"),
    ],
)
def test_manifests_that_cannot_be_followed(tmp_path, text, words):
    (tmp_path / "list.csv").write_text(text)
    with pytest.raises(pf.TargetError, match=words):
        items_of(tmp_path / "list.csv", OPTIONS)
