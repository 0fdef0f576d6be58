"""Whether anything became worse than the committed baseline."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.metric import Metric

BASELINE = Path(__file__).with_name("baseline.json")


def complaints(metrics: Sequence[Metric], mode: str, suites: Sequence[str]) -> list[str]:
    """A sentence for each metric that is worse than its tolerance allows, or that is not there.

    A peer that is not installed has no ratio: that is said in the results, and no complaint.

    Args:
        metrics: Of this run.
        mode: "quick" or "full": they have baselines of their own.
        suites: Those that ran.
    """
    if not BASELINE.exists():
        return [f"there is no {BASELINE.name}; make one with --update-baseline."]
    expected = json.loads(BASELINE.read_text(encoding="utf-8")).get(mode, {})
    if not expected:
        return [f"{BASELINE.name} has no {mode} run; make one with --update-baseline."]
    found = {metric.name: metric for metric in metrics}
    said = []
    for name, entry in expected.items():
        suite = name.partition(".")[0]
        if suite not in suites or (entry["optional"] and name not in found):
            continue
        metric = found.get(name)
        if metric is None:
            said.append(f"{name} is missing; it was {entry['value']:.4g}.")
        elif not metric.note.startswith("missing") and is_worse(metric, entry["value"]):
            said.append(
                f"{name} is {metric.value:.4g}, worse than {entry['value']:.4g} by more than "
                f"{metric.tolerance or 0:.0%}."
            )
    return said


def is_worse(metric: Metric, before: float) -> bool:
    """Beyond the metric's tolerance; never if it has none, always if it is no number any more."""
    if metric.tolerance is None:
        return False
    if not np.isfinite(metric.value):
        return bool(np.isfinite(before))
    room = metric.tolerance * abs(before)
    gap = metric.value - before if metric.better == "less" else before - metric.value
    return gap > room + 1e-12


def update(metrics: Sequence[Metric], mode: str, suites: Sequence[str]) -> None:
    """Write what is gated of these suites into the baseline; the rest of it stays."""
    whole = json.loads(BASELINE.read_text(encoding="utf-8")) if BASELINE.exists() else {}
    kept = {
        name: entry
        for name, entry in whole.get(mode, {}).items()
        if name.partition(".")[0] not in suites
    }
    new = {
        metric.name: {
            "value": float(f"{metric.value:.4g}"),
            "optional": metric.name.startswith(("real.", "area.")),
        }
        for metric in metrics
        if metric.tolerance is not None and np.isfinite(metric.value)
    }
    whole[mode] = dict(sorted((kept | new).items()))
    BASELINE.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
