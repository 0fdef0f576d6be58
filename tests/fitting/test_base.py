"""Which end of a blade is its base: a point near it, or "the other one"."""

import numpy as np
import pytest

import petalfit as pf
from petalfit.cli.fit import _base
from petalfit.cli.status import CommandError
from petalfit.fitting import tip_of

LEAF = pf.BladePetal(length=6.0, width=0.4, widest=0.35, bend=0.4, cup_mid=0.5)


@pytest.fixture(scope="module")
def scan():
    """A leaf somewhere in space, and the places of its base and its tip."""
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    place = lambda points: np.asarray(points, float) @ turn.T + [3.0, -2.0, 7.0]  # noqa: E731
    points = place(LEAF.sample(800, seed=2, noise=0.02).points)
    ends = np.asarray(LEAF(np.zeros(2), np.array([0.0, 1.0])), float)
    return points, *place(ends)


def base_of(result):
    return np.asarray(result.pose(np.asarray(result.model(0.0, 0.0), float)[None]))[0]


def fitted(points, **options):
    return pf.fit(pf.BladePetal, points, pose="similarity", throw=False, **options)


@pytest.fixture(scope="module")
def told(scan):
    points, *ends = scan
    return [fitted(points, base=tuple(end)) for end in ends]


def test_the_base_is_where_it_is_said_to_be(scan, told):
    _, base, tip = scan
    for result, place in zip(told, (base, tip), strict=True):
        assert np.linalg.norm(base_of(result) - place) < 0.1 * np.linalg.norm(tip - base)


def test_numbers_count_from_the_base(told):
    right, wrong = told
    assert right.values["widest"] == pytest.approx(0.35, abs=0.07)
    assert wrong.values["widest"] == pytest.approx(0.65, abs=0.07)


def test_the_other_end(scan, told):
    points, base, tip = scan
    usual, other = fitted(points), fitted(points, base="other")
    away = np.linalg.norm(base_of(other) - base_of(usual))
    assert away > 0.8 * np.linalg.norm(tip - base)
    assert np.linalg.norm(base_of(other) - tip_of(usual)) < 0.1 * np.linalg.norm(tip - base)


@pytest.mark.parametrize("base", ["tip", (1.0,), (0.0, np.nan, 1.0), "1,2,3"])
def test_what_is_no_place_is_refused(scan, base):
    with pytest.raises(ValueError, match="base must be a point"):
        fitted(scan[0], base=base)


def test_where_it_has_no_use_it_is_refused(scan):
    points = scan[0]
    with pytest.raises(pf.TargetError, match="the model's frame says where the base is"):
        pf.fit(pf.BladePetal, points, base="other")
    with pytest.raises(pf.TargetError, match="does not use base"):
        pf.fit(pf.PeonyPetal, points, pose="similarity", base=(0, 0, 0))
    with pytest.raises(pf.TargetError, match="does not use base"):
        pf.fit("auto", points, pose="similarity", base="other")
    with pytest.raises(pf.TargetError, match=r"a point \(x, y, z\) in a cloud; received 2 numbers"):
        pf.fit(pf.BladePetal, points, pose="similarity", base=(1.0, 2.0))
    with pytest.raises(pf.TargetError, match="for one cloud"):
        pf.fit(pf.BladePetal, [points, points], pose="similarity", base="other")


def test_words_of_the_command():
    assert _base("1,-2,0.5") == (1.0, -2.0, 0.5)
    assert _base("80,12.5") == (80.0, 12.5)
    assert _base("other") == "other"
    assert _base(None) is None
    with pytest.raises(CommandError, match="is no place"):
        _base("1;2;3")
