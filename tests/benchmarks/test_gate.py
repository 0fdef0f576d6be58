"""The gate closes on what became worse, what is missing and what crashed; and on nothing else."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from benchmarks import gate
from benchmarks.metric import Curve, Metric, slope
from benchmarks.page import surroundings, write_page
from benchmarks.peers import sampled_surface
from benchmarks.targets import NAMES, cramer_rao, off, petal_of
from petalfit import PeonyPetal

METRICS = [
    Metric("speed.ratio", 20.0, "×", "more", 0.5),
    Metric("recovery.error", 1.0, "×", "less", 0.2),
    Metric("speed.seconds", 0.1, "s", "less"),
    Metric("real.distance", 0.4, "%", "less", 0.1),
]


@pytest.fixture
def baseline(tmp_path, monkeypatch):
    monkeypatch.setattr(gate, "BASELINE", tmp_path / "baseline.json")
    gate.update(METRICS, "quick", ["speed", "recovery", "real"])
    return tmp_path / "baseline.json"


def closed(metrics, suites=("speed", "recovery", "real"), mode="quick"):
    return gate.complaints(metrics, mode, suites)


def test_an_equal_run_passes(baseline):
    assert closed(METRICS) == []
    assert "speed.seconds" not in json.loads(baseline.read_text())["quick"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (Metric("speed.ratio", 9.9, "×", "more", 0.5), "speed.ratio"),
        (Metric("recovery.error", 1.21, "×", "less", 0.2), "recovery.error"),
        (Metric("recovery.error", math.nan, "×", "less", 0.2), "recovery.error"),
    ],
)
def test_what_became_worse_closes_it(baseline, change, words):
    (sentence,) = closed([change if m.name == change.name else m for m in METRICS])
    assert words in sentence


@pytest.mark.parametrize(
    "change",
    [
        Metric("speed.ratio", 10.1, "×", "more", 0.5),
        Metric("speed.ratio", 99.0, "×", "more", 0.5),
        Metric("recovery.error", 0.1, "×", "less", 0.2),
        Metric("speed.seconds", 9.0, "s", "less"),
        Metric("speed.ratio", math.nan, "×", "more", 0.5, note="missing: Mitsuba"),
    ],
)
def test_what_did_not_leaves_it_open(baseline, change):
    assert closed([change if m.name == change.name else m for m in METRICS]) == []


def test_a_missing_number_closes_it_but_for_shapes_that_are_not_there(baseline):
    assert "speed.ratio is missing" in closed(METRICS[1:])[0]
    assert closed(METRICS[:3]) == []
    assert closed(METRICS[1:2], suites=("recovery",)) == []
    assert closed(METRICS, mode="full")


def test_updating_some_suites_keeps_the_others(baseline):
    gate.update([Metric("speed.ratio", 30.0, "×", "more", 0.5)], "quick", ["speed"])
    kept = json.loads(baseline.read_text())["quick"]
    assert kept["speed.ratio"]["value"] == 30
    assert kept["recovery.error"]["value"] == 1


def test_metrics():
    median = Metric.median("a.b", [1.0, 2.0, 3.0, 4.0, np.inf], "s", "less")
    assert (median.value, median.count) == (3.0, 5)
    assert median.spread == pytest.approx(0.75)
    rate = Metric.rate("a.c", [True, True, False, True], 0.1)
    assert rate.value == 0.75
    assert rate.spread == pytest.approx(np.sqrt(0.75 * 0.25 / 4))
    assert slope([1, 10, 100], [2, 20, 200]) == pytest.approx(1)


def test_the_peers_petal_is_ours():
    petal = petal_of(3)
    u, v = np.random.default_rng(0).uniform([-0.5, 0], [0.5, 1], (50, 2)).T
    theirs = sampled_surface.numpy_petal(sampled_surface.values_of(petal), u, v)
    assert np.asarray(petal(u, v)) == pytest.approx(theirs, rel=1e-4, abs=1e-4)
    assert sampled_surface.NAMES == NAMES


def test_starts_are_as_far_off_as_said():
    petal = petal_of(3)
    start = off(petal, NAMES, 0)
    ratios = [float(getattr(start, n)) / float(getattr(petal, n)) for n in NAMES]
    assert np.abs(np.array(ratios) - 1) == pytest.approx(0.05)
    assert isinstance(start, PeonyPetal)


def test_the_bound_shrinks_with_the_points():
    few, many = (cramer_rao(petal_of(3), n, 0) for n in (500, 8000))
    ratio = [few[name] / many[name] for name in NAMES]
    assert np.median(ratio) == pytest.approx(4, rel=0.2)


def test_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.page.HERE", tmp_path)
    curve = Curve("scaling.points", [1.0, 10.0], [0.1, 1.0], "points", "s", True, "points")
    write_page([*METRICS, Metric("speed.x", math.nan, "×", "more", note="missing: X")], [curve],
               surroundings(), 60.0, "quick")  # fmt: skip
    text = (tmp_path / "RESULTS.md").read_text()
    assert "| ratio | 20 × |" in text
    assert "missing: X" in text
    assert (tmp_path / "plots" / "points.png").exists()


def test_a_crash_fails(tmp_path):
    """A suite that cannot even be imported, and a name that is none."""
    run = [sys.executable, "-m", "benchmarks"]
    crashed = subprocess.run(
        [*run, "real", "--quick"], env={"PETALFIT_SHAPES": str(tmp_path), "JAX_PLATFORMS": "none"},
        capture_output=True, text=True,
    )  # fmt: skip
    assert crashed.returncode in (0, 1)
    unknown = subprocess.run([*run, "velocity"], capture_output=True, text=True)
    assert unknown.returncode == 2
    assert "recovery" in unknown.stderr
