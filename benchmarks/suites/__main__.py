"""One suite, in this process: `python -m benchmarks.suites NAME quick|full FILE`."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

from benchmarks.metric import Curve, Metric
from benchmarks.suites import suite
from petalfit.cli.console import progress
from petalfit.compilation.cache import compilation_cache


def main(name: str, mode: str, path: str) -> None:
    """Write the metrics and curves of a suite as JSON."""
    found: list[Metric | Curve] = []
    with progress(False) as show, compilation_cache():
        found += suite(name)(mode == "quick", lambda text: show(f"{name}: {text}"))
    content = {
        "metrics": [dataclasses.asdict(x) for x in found if isinstance(x, Metric)],
        "curves": [dataclasses.asdict(x) for x in found if isinstance(x, Curve)],
    }
    Path(path).write_text(json.dumps(content), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
