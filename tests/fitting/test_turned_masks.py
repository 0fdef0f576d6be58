"""A mask without a camera is fitted however the petal is turned in it; the base is the lower end."""

import dataclasses
import json
import math

import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.families.registry import family_of

from .conftest import random_blade, random_petal

BENT = family_of(pf.BladePetal()).depth
SIZE, FILLED = 160, 110.0


def masked(petal, turn):
    """A binary mask of a petal from the front, turned counterclockwise, and the pixels in its unit."""
    turned = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    rotation = np.diag([1.0, -1.0, -1.0]) @ turned
    places = np.asarray(petal.sample(4000, seed=1).points) @ rotation.T
    low, high = places.min(axis=0), places.max(axis=0)
    scale = FILLED / np.ptp(places[:, :2], axis=0).max()
    x, y, _ = np.array([80.3, 80.7, 0.0]) - 0.5 * scale * (low + high)
    camera = pf.Camera.orthographic(rotation, scale, (x, y), (SIZE, SIZE))
    return np.asarray(petal.silhouette(camera).mask) > 0.5, scale


def flat_blade(seed):
    return dataclasses.replace(
        random_blade(np.random.default_rng(seed)), **dict.fromkeys(BENT, 0.0)
    )


def apart(turn, other):
    return abs(math.remainder(turn - other, 2 * math.pi))


def fitted(mask, **options):
    return pf.fit_petal(mask, model=pf.BladePetal, throw=False, **options)


@pytest.fixture(scope="module")
def blades():
    """Flat blades in masks, each with its turn, the pixels in its unit and the fit of its mask."""
    found = []
    for seed in range(7000, 7003):
        blade = flat_blade(seed)
        turn = np.random.default_rng(seed).uniform(-np.pi, np.pi)
        mask, scale = masked(blade, turn)
        found.append((blade, turn, scale, mask, fitted(mask)))
    return found


def same_way(blade, turn, result):
    """The blade with its base where the result has it, and the turn of that base's end."""
    other = turn + math.pi - float(blade.sickle)
    if apart(result.values["turn_z"], turn) < apart(result.values["turn_z"], other):
        return blade, turn
    return blade.reversed(), other


def test_every_blade_is_found_with_its_base_below(blades):
    for blade, turn, scale, _, result in blades:
        assert result.converged
        upright = abs(result.values["turn_z"])
        assert upright < 0.5 * math.pi + 0.2
        assert apart(result.values["turn_z"], same_way(blade, turn, result)[1]) < 0.05
        assert result.traits["length"].value == pytest.approx(scale * blade.length, rel=0.01)
        # The other way round is as good, and is named.
        assert any(
            apart(one.values["turn_z"], result.values["turn_z"]) > 2 for one in result.rivals
        )


def test_intervals_of_turned_blades_cover_the_truth(blades):
    z = []
    for blade, turn, _, _, result in blades:
        true, _ = same_way(blade, turn, result)
        names = [name for name in result.names if hasattr(true, name) and result.identifiable[name]]
        assert {"width", "widest"} <= set(names)
        assert not set(names) & set(BENT)
        z += [(result.values[n] - getattr(true, n)) / result.stderr[n] for n in names]
    covered = np.mean(np.abs(z) < 1.96)
    print(f"95 % intervals cover {covered:.3f} of {len(z)}")
    assert 0.85 <= covered <= 1.0
    assert np.max(np.abs(z)) < 5


def test_a_place_in_pixels_says_where_the_base_is(blades):
    _, _, _, mask, result = blades[0]
    tip = result.pose(np.asarray(result.model(0.0, 1.0), np.float64)[None])[0, :2]
    for other in (fitted(mask, base=tip.tolist()), fitted(mask, base="other")):
        assert other.converged
        assert apart(other.values["turn_z"], result.values["turn_z"]) > 2.5
        base = other.pose(np.zeros((1, 3)))[0, :2]
        assert np.linalg.norm(base - tip) < 2
    with pytest.raises(pf.TargetError, match=r"a place in pixels \(x, y\)"):
        fitted(mask, base=(1.0, 2.0, 3.0))


def test_an_earlier_result_and_its_profile_begin_at_its_place(blades):
    _, _, _, mask, result = blades[1]
    again = fitted(mask, init=result)
    for name in result.names:
        if result.identifiable[name]:
            assert abs(again.values[name] - result.values[name]) < 3 * result.stderr[name]
    profile = result.with_profile("width", points=5).profiles["width"]
    low, high = profile.interval()
    assert low < result.values["width"] < high


@pytest.mark.parametrize("turn", [0.5, math.pi, -1.7])
def test_the_outline_of_a_peony_petal_tells_base_and_tip(turn):
    petal = random_petal(np.random.default_rng(2))
    mask, scale = masked(petal, turn)
    result = pf.fit_petal(mask)
    assert apart(result.values["turn_z"], turn) < 0.03
    assert result.values["c"] == pytest.approx(petal.c, abs=0.03)
    assert result.pose.scale * result.values["b_y"] == pytest.approx(scale * petal.b_y, rel=0.02)


def test_a_file_keeps_the_turn_and_older_files_have_none(blades, tmp_path):
    result = blades[0][4]
    result.save(tmp_path / "fit.json")
    loaded = pf.FitResult.load(tmp_path / "fit.json")
    assert loaded.values["turn_z"] == result.values["turn_z"]
    content = json.loads((tmp_path / "fit.json").read_bytes())
    for values in (content[k] for k in ("values", "stderr", "identifiable", "stderr_noise")):
        del values["turn_z"]
    content["names"].remove("turn_z")
    content["covariance"] = [row[:-1] for row in content["covariance"][:-1]]
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert "turn_z" not in pf.FitResult.load(tmp_path / "old.json").values
