"""Two thousand files, a killed worker and an interrupted run on a local Dask cluster."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet
import pytest

import petalfit as pf
from petalfit.synthetic import random_petal

COUNT = int(os.environ.get("PETALFIT_FILES", 2000))


def rotten(path: Path, kind: int) -> None:
    """Five ways not to be a petal."""
    if kind == 0:
        path.touch()
    elif kind == 1:
        path.write_bytes(b"\x93NUMPY and then nothing")
    else:
        bad = [np.full((500, 3), np.nan), np.ones((4, 3)), np.zeros((500, 3))]
        np.save(path, bad[kind - 2])


@pytest.mark.slow
def test_every_target_has_one_row(tmp_path: Path) -> None:
    source, out = tmp_path / "source", tmp_path / "out"
    source.mkdir()
    rng = np.random.default_rng(0)
    clouds = [
        random_petal(np.random.default_rng(seed)).sample(500, seed=seed, noise=0.05).points
        for seed in range(20)
    ]
    bad = {f"{k:05d}.npy" for k in rng.choice(COUNT, COUNT // 20, replace=False)}
    for k in range(COUNT):
        path = source / f"{k:05d}.npy"
        if path.name in bad:
            rotten(path, k % 5)
        else:
            np.save(path, clouds[k % 20][rng.permutation(500)])
    command = [sys.executable, "-m", "petalfit", "batch", str(source), "--out", str(out),
               "--scheduler", "local", "--workers", "2"]  # fmt: skip

    def finished() -> int:
        return sum(1 for _ in out.rglob("record.json"))

    def wait_for(count: int) -> None:
        began = time.monotonic()
        while finished() < count:
            assert run.poll() is None, "it ended"
            assert time.monotonic() - began < 900, "it hangs"
            time.sleep(0.2)

    run = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    wait_for(COUNT // 2)
    children = psutil.Process(run.pid).children(recursive=True)
    worker = max(children, key=lambda child: child.cpu_times().user)
    os.kill(worker.pid, signal.SIGKILL)
    wait_for(COUNT * 3 // 4)
    os.killpg(run.pid, signal.SIGINT)
    assert run.wait(timeout=60) == 130
    kept = pyarrow.parquet.read_table(out / "table.parquet")
    assert COUNT * 3 // 4 <= len(kept) == finished() < COUNT

    again = subprocess.run(command, capture_output=True, text=True)
    assert again.returncode == 3, again.stderr
    rows = pyarrow.parquet.read_table(out / "table.parquet").to_pylist()
    assert Counter(row["id"] for row in rows) == Counter(f"{k:05d}.npy" for k in range(COUNT))
    for row in rows:
        if row["id"] in bad:
            assert row["status"] == "unusable"
            assert len(row["message"]) > 20
        else:
            assert row["status"] != "unusable"
            result = pf.FitResult.load(out / "fits" / row["id"] / "fit.json")
            assert result.values["a_x"] == row["a_x"]
    before = {row["id"]: row["finished"] for row in kept.to_pylist()}
    assert all(row["finished"] == before.get(row["id"], row["finished"]) for row in rows)
