"""How the cost grows: with the points of one cloud, and with the number of clouds."""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Iterator

import numpy as np

import petalfit as pf
from benchmarks.metric import Curve, Metric, Tell, slope
from benchmarks.targets import cloud_of, petal_of

_BATCH_POINTS = 500
_KINDS = 64  # different clouds in a batch


def run(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    yield from _points(quick, tell)
    yield from _fits(quick, tell)


def _points(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    sizes = [100, 1000, 10_000, 100_000] + ([] if quick else [1_000_000])
    petal, times = petal_of(6000), []
    for n in sizes:
        tell(f"{n} points")
        points = cloud_of(petal, n, 0)
        pf.fit_petal(points, throw=False)
        repeats = 3 if n <= 10_000 else 1
        each = []
        for _ in range(repeats):
            began = time.perf_counter()
            pf.fit_petal(points, throw=False)
            each.append(time.perf_counter() - began)
        times.append(float(np.median(each)))
        yield Metric(f"scaling.seconds_{n}_points", times[-1], "s", "less", count=repeats)
    # From where the points outweigh what every fit costs.
    yield Metric(
        "scaling.exponent_points", slope(sizes[1:], times[1:]), "1", "less", 0.2,
        note=f"of the time, from {sizes[1]} to {sizes[-1]} points",
    )  # fmt: skip
    yield Curve(
        "scaling.points", [*map(float, sizes)], times, "points", "seconds of a warm fit",
        log=True, group="points",
    )  # fmt: skip


def _fits(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    counts = [1, 4, 16, 64] + ([] if quick else [256, 1024])
    clouds = [cloud_of(petal_of(7000 + k), _BATCH_POINTS, k) for k in range(_KINDS)]
    pf.fit_petal(clouds[0], throw=False)
    tell("starting the workers")
    pf.fit_batch(clouds[:8])
    times = []
    for count in counts:
        tell(f"{count} fits")
        targets = [clouds[k % _KINDS] for k in range(count)]
        began = time.perf_counter()
        pf.fit_batch(targets)
        times.append(time.perf_counter() - began)
    began = time.perf_counter()
    for k in range(counts[-1]):
        pf.fit_petal(clouds[k % _KINDS], throw=False)
    loop = time.perf_counter() - began
    yield Metric("scaling.seconds_a_fit_in_batch", times[-1] / counts[-1], "s", "less")
    yield Metric(
        "scaling.batch_over_loop", times[-1] / loop, "×", "less", 0.15,
        note=f"{counts[-1]} clouds of {_BATCH_POINTS} points on {multiprocessing.cpu_count()} cores",
    )  # fmt: skip
    yield Metric(
        "scaling.exponent_fits", slope(counts[2:], times[2:]), "1", "less", 0.15,
        note=f"of the time, from {counts[2]} to {counts[-1]} fits",
    )  # fmt: skip
    yield Curve(
        "scaling.fits", [*map(float, counts)], times, "fits", "seconds of a batch", log=True,
        group="fits",
    )  # fmt: skip
    few, many = (64, 256) if quick else (256, 4096)
    memory = []
    for count in (few, many):
        tell(f"memory of {count} fits")
        for _ in pf.fit_batch(clouds[k % _KINDS] for k in range(count)):
            pass
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    yield Metric("scaling.memory", memory[-1], "MB", "less", note="peak of the process that waits")
    yield Metric(
        "scaling.memory_growth", memory[1] / memory[0], "×", "less", 0.1,
        note=f"of that peak, from {few} to {many} targets of a stream",
    )  # fmt: skip
