"""How the cost grows: with the points of one cloud, and with the number of clouds."""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Iterator
from contextlib import suppress

import petalfit as pf
from benchmarks.metric import Curve, Metric, Tell, slope, timed
from benchmarks.targets import cloud_of, petal_of

_BATCH_POINTS = 500
_KINDS = 64  # different clouds in a batch


def run(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    yield from _points(quick, tell)
    yield from _blades(quick, tell)
    yield from _fits(quick, tell)


def _points(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    sizes = [1000, 50_000] if quick else [100, 1000, 10_000, 100_000, 1_000_000]
    petal, times = petal_of(6000), []
    for n in sizes:
        tell(f"{n} points")
        points = cloud_of(petal, n, 0)
        repeats = 3 if n <= 10_000 else 1
        taken, _ = timed(lambda points=points: pf.fit_petal(points, throw=False), repeats)
        times.append(taken)
        yield Metric(f"scaling.seconds_{n}_points", times[-1], "s", "less", count=repeats)
    large = sizes[-3:]  # where the points outweigh what every fit costs
    yield Metric(
        "scaling.exponent_points", slope(large, times[-3:]), "1", "less", 0.2,
        note=f"of the time, from {large[0]} to {large[-1]} points",
    )  # fmt: skip
    yield Curve(
        "scaling.points", [*map(float, sizes)], times, "points", "seconds of a warm fit",
        log=True, group="points",
    )  # fmt: skip


def _blades(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    """The same for a blade in an unknown pose, whose larger clouds are condensed."""
    sizes = [2000, 100_000] + ([] if quick else [1_000_000])
    blade = pf.BladePetal(bend=0.8, cup_mid=0.4, twist=0.2, tip_roll=0.3, skew=0.1, keel=0.1)
    times = []
    for n in sizes:
        tell(f"a blade of {n} points")
        points = blade.sample(n, seed=1, noise=0.01).points
        pf.fit_petal(points[:2000], model=pf.BladePetal, pose="similarity", throw=False)
        taken, _ = timed(
            lambda points=points: pf.fit_petal(
                points, model=pf.BladePetal, pose="similarity", throw=False
            ),
            3 if n <= 10_000 else 1,
        )
        times.append(taken)
        yield Metric(f"scaling.blade_seconds_{n}_points", taken, "s", "less")
        if n > sizes[0]:
            yield Metric(
                f"scaling.blade_{n}_over_{sizes[0]}", taken / times[0], "×", "less", 0.5,
                note=f"of the time for {sizes[0]} points, in one run",
            )  # fmt: skip


def _fits(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    counts = [1, 4, 16, 64] + ([] if quick else [256])
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
    turns = counts[-2] if quick else counts[-1]
    began = time.perf_counter()
    for k in range(turns):
        pf.fit_petal(clouds[k % _KINDS], throw=False)
    alone, together = (time.perf_counter() - began) / turns, times[-1] / counts[-1]
    yield Metric("scaling.seconds_a_fit_in_batch", together, "s", "less")
    yield Metric(
        "scaling.batch_over_loop", together / alone, "×", "less", 0.15,
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
    few, many = (16, 64) if quick else (64, 1024)
    peaks = []
    for count in (few, many):
        tell(f"memory of {count} fits")
        peaks.append(_peak(count))
    yield Metric("scaling.memory", peaks[-1], "MB", "less", note="of all processes, the peak")
    yield Metric(
        "scaling.memory_growth", peaks[1] / peaks[0], "×", "less", 0.15,
        note=f"of that peak, from {few} to {many} targets of a stream",
    )  # fmt: skip


def _peak(count: int) -> float:
    """The most memory, in MB, that a process and its workers hold that fit a stream of clouds."""
    import psutil

    code = (
        "import sys; from benchmarks.suites.scaling import stream\n"
        "if __name__ == '__main__': stream(int(sys.argv[1]))"
    )
    process = psutil.Popen([sys.executable, "-c", code, str(count)])
    peak = 0
    while process.poll() is None:
        with suppress(psutil.Error):
            family = [process, *process.children(recursive=True)]
            # Of each page its share, where the system tells it: what processes share counts once.
            peak = max(peak, sum(p.memory_full_info().uss for p in family))
        time.sleep(0.2)
    if process.returncode != 0:
        raise RuntimeError(f"a stream of {count} fits ended with status {process.returncode}")
    return peak / 1e6


def stream(count: int) -> None:
    """Fit clouds that nobody keeps."""
    clouds = [cloud_of(petal_of(7000 + k), _BATCH_POINTS, k) for k in range(8)]
    for _ in pf.fit_batch(clouds[k % len(clouds)] for k in range(count)):
        pass
