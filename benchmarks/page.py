"""`RESULTS.md` and its plots, from the JSON of a run."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.metric import Curve, Metric

HERE = Path(__file__).parent
_TITLES = {
    "startup": "Starting",
    "recovery": "Random petals from clouds",
    "silhouette": "Random petals from one mask",
    "robustness": "Clutter, noise, holes, pose",
    "real": "Petals that nobody generated",
    "area": "Their areas, from points with a hole",
    "speed": "Speed, and other tools",
    "scaling": "Many points, many targets",
    "studio": "The studio in a browser",
}
_PACKAGES = (
    "petalfit",
    "jax",
    "jaxlib",
    "optimistix",
    "lineax",
    "numpy",
    "scipy",
    "lmfit",
    "mitsuba",
    "open3d",
    "viser",
)


def surroundings() -> dict[str, Any]:
    """What the numbers depend on besides the code."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(x.partition(":")[2].strip() for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        pass
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
    }


def write_page(
    metrics: Sequence[Metric],
    curves: Sequence[Curve],
    about: dict[str, Any],
    seconds: float,
    mode: str,
) -> None:
    """`RESULTS.md` beside this file, and `plots/`."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    lines = [
        "# Benchmark results",
        "",
        "Written by `python -m benchmarks --results`; every number can be made again with it. Ratios "
        "compare runs in one process, one after the other. ± is half the distance of the quartiles, or "
        "the standard error of a rate. The first call of everything compiles, or warms caches: it is "
        "discarded, and nothing else is.",
        "",
        f"{about['processor']}, {about['cores']} cores, {about['system']}, Python {about['python']}. "
        f"{versions}. A {mode} run, {seconds / 60:.0f} minutes in all.",
    ]
    drawn = _draw(curves)
    for suite, title in _TITLES.items():
        own = [metric for metric in metrics if metric.name.partition(".")[0] == suite]
        if not own:
            continue
        lines += ["", f"## {title}", "", "| | | ± | of | |", "|---|---:|---:|---:|---|"]
        for metric in own:
            value = "–" if not np.isfinite(metric.value) else _text(metric.value, metric.unit)
            spread = _text(metric.spread, metric.unit) if metric.spread else ""
            count = str(metric.count) if metric.count > 1 else ""
            name = metric.name.partition(".")[2].replace("_", " ")
            lines.append(f"| {name} | {value} | {spread} | {count} | {metric.note} |")
        lines += [f"\n![{name}](plots/{name}.png)" for name, of in drawn.items() if of == suite]
    (HERE / "RESULTS.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _text(value: float, unit: str) -> str:
    if unit == "1":
        return f"{value:.3g}"
    return f"{value:.3g} {unit}" if unit != "%" else f"{value:.2g} %"


def _draw(curves: Sequence[Curve]) -> dict[str, str]:
    """A picture for each group of curves; its name and its suite."""
    from matplotlib.figure import Figure

    (HERE / "plots").mkdir(exist_ok=True)
    drawn = {}
    for group in dict.fromkeys(curve.group for curve in curves):
        own = [curve for curve in curves if curve.group == group]
        figure = Figure(figsize=(5.2, 3.4), layout="constrained")
        axes = figure.subplots()
        for curve in own:
            label, _, names = curve.x_label.partition(": ")
            axes.plot(curve.x, curve.y, "o-", label=curve.name.partition(".")[2])
            if names:
                axes.set_xticks(curve.x, names.split(", "), rotation=45, ha="right")
                axes.axhline(1, color="grey", linewidth=0.8)
            if curve.log:
                axes.set_xscale("log")
                axes.set_yscale("log")
            else:
                axes.set_ylim(bottom=0)
            axes.set_xlabel(label)
            axes.set_ylabel(curve.y_label)
        if len(own) > 1:
            axes.legend(frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(HERE / "plots" / f"{group}.png", dpi=110)
        drawn[group] = own[0].name.partition(".")[0]
    return drawn
