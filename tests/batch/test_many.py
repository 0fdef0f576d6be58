"""`fit_batch`: what `fit` says of each target, from all cores."""

import numpy as np
import pytest

import petalfit as pf
from petalfit.batch.processes import Crash

TRUTH = [pf.Ellipsoid(1.0 + 0.1 * k, 2.0, 3.0) for k in range(5)]
CLOUDS = [truth.sample(300 + 17 * k, seed=k, noise=0.01) for k, truth in enumerate(TRUTH)]
BAD = np.full((100, 3), np.nan)


@pytest.fixture(scope="module")
def outcomes():
    targets = [CLOUDS[0], BAD, "no/such/file.ply", *CLOUDS[1:]]
    told = []
    found = pf.fit_batch(targets, model=pf.Ellipsoid, workers=2, progress=told.append)
    return found, told


def test_every_target_has_a_result_in_its_place(outcomes):
    found, told = outcomes
    assert [type(outcome) for outcome in found] == [
        pf.FitResult, pf.FitFailure, pf.FitFailure, *4 * [pf.FitResult]
    ]  # fmt: skip
    for outcome, truth in zip([found[0], *found[3:]], TRUTH, strict=True):
        assert outcome.values["r_x"] == pytest.approx(truth.r_x, abs=0.01)
        assert outcome.converged
    assert [outcome.status for outcome in found[1:3]] == ["unusable", "unusable"]
    assert "finite" in found[1].message
    assert "no/such/file.ply" in found[2].message
    assert not found[1].converged
    assert told[-1] == "7 of 7 fitted, 2 without success"


def test_it_says_what_fit_says(outcomes):
    alone = pf.fit(pf.Ellipsoid, CLOUDS[2])
    for name, value in alone.values.items():
        assert outcomes[0][4].values[name] == pytest.approx(value, abs=1e-9)
    assert outcomes[0][4].stderr == pytest.approx(alone.stderr, rel=1e-6)


def test_a_stream_gives_a_stream():
    taken = []

    def stream():
        for cloud in CLOUDS:
            taken.append(cloud)
            yield cloud

    found = pf.fit_batch(stream(), model=pf.Ellipsoid, workers=1)
    assert not taken
    assert next(found).converged
    assert len(taken) == 1
    assert len([*found]) == 4


def test_a_crash_is_a_failure_with_words(monkeypatch):
    monkeypatch.setattr("petalfit.batch.many.in_order", lambda *_: iter([Crash()]))
    crashed = next(pf.fit_batch(iter(CLOUDS), model=pf.Ellipsoid, workers=2))
    assert isinstance(crashed, pf.FitFailure)
    assert crashed.status == "crashed"
    assert "memory" in crashed.message


def test_one_target_is_not_many():
    for single in (CLOUDS[0], CLOUDS[0].points, "petal.ply", 3):
        with pytest.raises(pf.TargetError, match="list"):
            pf.fit_batch(single)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"workers": 0}, "1 or more"),
        ({"free": ["a_z"]}, "a_z"),
        ({"pose": "somewhere"}, "pose must be"),
        ({"noise": -1.0}, "noise must be"),
        ({"model": "auto", "free": ["a_x"]}, "neither"),
    ],
)
def test_options_that_no_target_can_be_fitted_with(options, words):
    with pytest.raises(ValueError, match=words):
        pf.fit_batch(CLOUDS, **options)


@pytest.mark.parametrize("free", ["r_x", iter(["r_x"])], ids=["one name", "an iterator"])
def test_free_is_whatever_fit_takes(free):
    (result,) = pf.fit_batch(CLOUDS[:1], model=pf.Ellipsoid(1.0, 2.0, 3.0), free=free, workers=1)
    assert result.names == ("r_x",)


def test_nothing_to_fit():
    assert pf.fit_batch([]) == []
