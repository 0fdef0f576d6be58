"""Which end of a blade is its base: a point near it, or "the other one"."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import petalfit as pf
from petalfit.cli.fit import _base
from petalfit.cli.status import CommandError
from petalfit.fitting import tip_of
from petalfit.fitting.families.registry import family_of
from petalfit.fitting.solver.iterate import Iterate

from .conftest import random_blade

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
    with pytest.raises(pf.TargetError, match=r"a point \(x, y, z\) in space; received 2 numbers"):
        pf.fit(pf.BladePetal, points, pose="similarity", base=(1.0, 2.0))
    with pytest.raises(pf.TargetError, match="for one cloud"):
        pf.fit(pf.BladePetal, [points, points], pose="similarity", base="other")


@pytest.mark.parametrize("seed", range(4))
def test_the_other_way_is_nearly_the_same_surface(seed):
    blade = random_blade(np.random.default_rng(seed))
    turn = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    posed = pf.components.Posed(blade, turn, np.array([5.0, -2.0, 1.0]), np.float64(3.0))
    other = family_of(blade).the_other_way(posed)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(0, 1, 81))
    own, theirs = (np.asarray(one(u, v), float).reshape(-1, 3) for one in (posed, other))
    away = KDTree(own).query(theirs)[0]
    assert np.sqrt(np.mean(away**2)) < 0.02 * 30
    ends = [np.asarray(one(np.zeros(2), np.array([0.0, 1.0])), float) for one in (posed, other)]
    assert np.abs(ends[0][::-1] - ends[1]).max() < 0.05 * 30


def test_a_blade_with_its_hollow_side_down_is_turned_over_in_any_pose():
    blade = random_blade(np.random.default_rng(1)).turned_over()
    turn = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    pose = (turn, np.array([5.0, -2.0, 1.0]), np.float64(3.0), 1.1, 0.2, -0.1, 0.3, 0.5, -0.2, 0.4)
    posed = pf.components.Posed(blade, *pose)
    names = ("length", "bend", "turn_x", "turn_y")
    end = Iterate(posed, (), 1, 0.0, np.zeros(4), information=np.arange(16.0).reshape(4, 4))
    over = family_of(blade).standard_form(end, names)
    assert float(over.model.surface.bend) == -float(blade.bend)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(0, 1, 9))
    np.testing.assert_allclose(over.model(-u, v), posed(u, v), rtol=0, atol=1e-4)
    signs = np.array([1.0, -1.0, -1.0, 1.0])
    np.testing.assert_array_equal(over.information, np.outer(signs, signs) * end.information)


FREE = ("length", "width", "widest", "base_width", "tip_width", "bend", "cup_mid")
EYES = np.array([[30.0, -40.0, 60.0], [-50.0, 20.0, 40.0], [20.0, 50.0, 30.0]])


@pytest.fixture(scope="module")
def seen():
    """Masks of the leaf from three sides, each with its camera, and the places of base and tip."""
    leaf = pf.BladePetal(length=20.0, width=0.4, widest=0.42, bend=0.5, cup_mid=0.4, tip_width=0.15)
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    posed = pf.components.Posed(leaf, turn, np.array([2.0, -3.0, 1.0]), np.float64(1.0))
    ends = np.asarray(posed(np.zeros(2), np.array([0.0, 1.0])), float)
    cameras = [
        pf.Camera.look_at(
            ends.mean(axis=0) + eye, ends.mean(axis=0), (160, 160), field_of_view=0.35
        )
        for eye in EYES
    ]
    masks = [np.asarray(posed.silhouette(camera).mask) >= 0.5 for camera in cameras]
    return [*map(pf.Silhouette, masks, cameras)], *ends


def test_masks_from_several_sides_do_not_tell_base_and_tip(seen):
    masks, base, tip = seen
    fit = lambda **options: pf.fit(pf.BladePetal, masks, pose="rigid", free=FREE, **options)  # noqa: E731
    # The leaf is widest below its middle, and petals usually are above it.
    usual, told = fit(), fit(base=tuple(base))
    assert usual.values["widest"] > 0.5
    assert "base and tip exchanged" in [rival.label for rival in usual.rivals]
    for result, place in ((usual, tip), (told, base)):
        assert np.linalg.norm(base_of(result) - place) < 0.05 * np.linalg.norm(tip - base)
    # The hollow side is up, from whatever side the masks are.
    for name, value in (("length", 20.0), ("widest", 0.42), ("base_width", 0.2), ("bend", 0.5)):
        assert abs(told.values[name] - value) < 4 * told.stderr[name] + 1e-3


def test_words_of_the_command():
    assert _base("1,-2,0.5") == (1.0, -2.0, 0.5)
    assert _base("80,12.5") == (80.0, 12.5)
    assert _base("other") == "other"
    assert _base(None) is None
    with pytest.raises(CommandError, match="is no place"):
        _base("1;2;3")
