"""What a process costs before it fits: import, help, compiling, and loading what was compiled."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.metric import Metric, Tell
from benchmarks.targets import cloud_of, petal_of


def run(quick: bool, tell: Tell) -> Iterator[Metric]:
    repeats = 3 if quick else 7
    tell("imports")
    python = _median([sys.executable, "-c", "pass"], repeats)
    package = _median([sys.executable, "-c", "import petalfit"], repeats)
    helped = _median([sys.executable, "-m", "petalfit", "--help"], repeats)
    yield Metric("startup.python", python, "s", "less", count=repeats)
    yield Metric(
        "startup.import_over_python", package / python, "×", "less", 0.5, count=repeats,
        note="import petalfit, over a process that does nothing",
    )  # fmt: skip
    yield Metric("startup.help_over_python", helped / python, "×", "less", 0.5, count=repeats)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        np.savetxt(folder / "petal.xyz", cloud_of(petal_of(0), 1500, 0))
        command = [sys.executable, "-m", "petalfit", "fit", str(folder / "petal.xyz"), "--out"]
        environment = os.environ | {"PETALFIT_CACHE": str(folder / "cache")}
        tell("the first fit of a machine")
        first = _once([*command, str(folder / "first")], environment)
        tell("the second")
        second = [
            _once([*command, str(folder / f"second{k}")], environment) for k in range(repeats)
        ]
    yield Metric("startup.first_fit", first, "s", "less", note="petalfit fit, with compiling")
    yield Metric.median(
        "startup.next_fit",
        second,
        "s",
        "less",
        note="petalfit fit, compiled before; report included",
    )
    yield Metric(
        "startup.next_over_first", float(np.median(second)) / first, "×", "less", 0.5, count=repeats
    )


def _median(command: list[str], repeats: int) -> float:
    _once(command, None)
    return float(np.median([_once(command, None) for _ in range(repeats)]))


def _once(command: list[str], environment: dict[str, str] | None) -> float:
    began = time.perf_counter()
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began
