"""`python -m benchmarks`: how well, how fast, how robustly petals are fitted, beside other tools.

Every suite runs in a process of its own, so that a crash of one is a failure and no end of the others.
In a quick run those that measure no time run two at a time.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional, arg

from benchmarks import gate
from benchmarks.metric import Curve, Metric
from benchmarks.page import surroundings, write_page
from benchmarks.suites import NAMES, UNTIMED

_FAILED, _WRONG = 1, 2


def main(
    suites: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="SUITE", help=f"Of {', '.join(NAMES)}; all without."),
    ] = (),
    quick: Annotated[bool, arg(help="Fewer petals: under five minutes on two cores.")] = False,
    json_file: Annotated[
        Path | None, arg(name="json", metavar="FILE", help="Write all numbers there.")
    ] = None,
    check: Annotated[
        bool, arg(name="gate", help="Fail if something is worse than benchmarks/baseline.json.")
    ] = False,
    update_baseline: Annotated[
        bool, arg(help="Write the numbers of these suites into benchmarks/baseline.json.")
    ] = False,
    results: Annotated[
        bool, arg(help="Write benchmarks/RESULTS.md and its plots; all suites have to run.")
    ] = False,
) -> int:
    """Run benchmarks. Exit status 1 if a suite crashed or the gate is closed."""
    unknown = [name for name in suites if name not in NAMES]
    if unknown:
        print(
            f"there is no suite {', '.join(unknown)}; there are {', '.join(NAMES)}.",
            file=sys.stderr,
        )
        return _WRONG
    chosen = [name for name in NAMES if not suites or name in suites]
    if results and len(chosen) < len(NAMES):
        print("--results needs all suites; name none.", file=sys.stderr)
        return _WRONG
    began = time.monotonic()
    metrics: list[Metric] = []
    curves: list[Curve] = []
    crashed = []
    for name, seconds, content in _results(chosen, quick):
        if content is None:
            crashed.append(name)
            continue
        own = [Metric(**entry) for entry in content["metrics"]]
        metrics += own
        curves += [Curve(**entry) for entry in content["curves"]]
        print(f"{name}, {seconds:.0f} s")
        for metric in own:
            print(_line(metric))
    seconds = time.monotonic() - began
    about = surroundings()
    if json_file is not None:
        content = {"about": about, "quick": quick, "seconds": seconds, "crashed": crashed}
        content["metrics"] = [dataclasses.asdict(metric) for metric in metrics]
        content["curves"] = [dataclasses.asdict(curve) for curve in curves]
        json_file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    mode = "quick" if quick else "full"
    failed = [f"the suite {name} crashed." for name in crashed]
    if check:
        failed += gate.complaints(metrics, mode, chosen)
        print(f"gate {'closed' if failed else 'open'}, after {seconds:.0f} s")
    if update_baseline and not crashed:
        gate.update(metrics, mode, chosen)
    if results and not crashed:
        write_page(metrics, curves, about, seconds, mode)
    for sentence in failed:
        print(sentence, file=sys.stderr)
    return _FAILED if failed else 0


def _results(
    chosen: Sequence[str], quick: bool
) -> Iterator[tuple[str, float, dict[str, Any] | None]]:
    """What each suite found, and how long it took, in their order."""

    def run(name: str) -> tuple[str, float, dict[str, Any] | None]:
        since = time.monotonic()
        content = _run_apart(name, quick)
        return name, time.monotonic() - since, content

    for untimed, names in itertools.groupby(chosen, lambda name: quick and name in UNTIMED):
        with ThreadPoolExecutor(2 if untimed else 1) as executor:
            yield from executor.map(run, names)


def _run_apart(name: str, quick: bool) -> dict[str, Any] | None:
    """A suite in a process of its own; None if that did not end well."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "suite.json"
        mode = "quick" if quick else "full"
        command = [sys.executable, "-m", "benchmarks.suites", name, mode, str(path)]
        ended = subprocess.run(command)
        if ended.returncode != 0 or not path.exists():
            print(f"{name} crashed with status {ended.returncode}", file=sys.stderr)
            return None
        return json.loads(path.read_text(encoding="utf-8"))


def _line(metric: Metric) -> str:
    value = f"{metric.value:.4g}" if math.isfinite(metric.value) else "–"
    spread = f"± {metric.spread:.2g}" if metric.spread else ""
    return f"  {metric.name:<40}{value:>9} {metric.unit:<2} {spread:<10} {metric.note}"


if __name__ == "__main__":
    sys.exit(tyro.cli(main, config=(tyro.conf.FlagCreatePairsOff,)))
