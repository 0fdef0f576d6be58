"""A petal on a table, with its stalk: what is not the petal is left out."""

import numpy as np
import pytest

import petalfit as pf
from benchmarks.targets import buried
from petalfit.fitting.outliers.other_sheets import on_other_sheets
from petalfit.synthetic import random_petal

SIGMA = 0.002  # of a blade whose length is 1
BLADE = pf.BladePetal(length=1.0, width=0.5, bend=0.6, tip_roll=0.4, cup_mid=0.7, twist=0.2)
DENSITY = 2000 / float(BLADE.area())  # points by area


def noisy(points, rng):
    return points + SIGMA * rng.normal(size=points.shape)


def blade(n, seed=1):
    return np.asarray(BLADE.sample(n, seed=seed, noise=SIGMA).points)


def table(points, side, rng):
    """Points of a square table under others, as dense as those of a blade with 2,000 points."""
    count = int(DENSITY * side**2)
    low = points[:, 2].min() - 0.03
    across = rng.uniform(-side / 2, side / 2, (count, 2)) + points[:, :2].mean(axis=0)
    return noisy(np.column_stack([across, np.full(count, low)]), rng)


def stalk(base, length, radius, rng):
    """Points of a tube that leads from the base of a blade, as dense as those of the blade."""
    count = int(DENSITY * 2 * np.pi * radius * length)
    angle, way = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, length, count)
    ring = radius * np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    return noisy(base + ring - way[:, None] * [0.0, 1.0, 0.0], rng)


def left_out(*parts):
    """The share of each part that lies on other sheets."""
    points = np.concatenate(parts)
    found = on_other_sheets(points)
    ends = np.cumsum([len(part) for part in parts])[:-1]
    return [float(share.mean()) for share in np.split(found, ends)]


def test_a_table_and_a_stalk_are_left_out():
    rng = np.random.default_rng(0)
    petal = blade(2000)
    base = petal[np.argmin(petal[:, 1])]
    for radius in (0.015, 0.04):
        kept, *others = left_out(petal, table(petal, 1.1, rng), stalk(base, 0.6, radius, rng))
        assert kept < 0.04
        assert min(others) > 0.6


@pytest.mark.parametrize("seed", range(2))
def test_of_a_petal_alone_nothing_is_left_out(seed):
    petal = random_petal(np.random.default_rng(seed))
    assert left_out(np.asarray(petal.sample(2000, seed=seed, noise=0.05).points)) == [0.0]
    scene = buried(seed, 0.6)
    found = on_other_sheets(scene.points)
    assert found[scene.inside].mean() == 0.0


def test_a_flat_petal_is_no_table():
    rng = np.random.default_rng(2)
    flat = noisy(
        np.column_stack([rng.uniform(-0.3, 0.3, 2000), rng.uniform(0, 1, 2000), np.zeros(2000)]),
        rng,
    )
    aside = noisy(
        np.column_stack([rng.uniform(1, 2, 900), rng.uniform(0, 1, 900), np.full(900, 0.4)]), rng
    )
    assert left_out(flat, aside) == [0.0, 0.0]
    assert left_out(blade(300)) == [0.0]
    assert left_out(flat, stalk(np.zeros(3), 0.6, 0.03, rng))[0] < 0.01


def test_a_petal_on_a_table_is_fitted():
    rng = np.random.default_rng(3)
    petal = blade(2000)
    under = table(petal, 1.3, rng)
    beside = stalk(petal[np.argmin(petal[:, 1])], 0.5, 0.015, rng)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = 40 * np.concatenate([petal, under, beside]) @ (turn * np.linalg.det(turn)).T
    result = pf.fit_petal(
        points, model=pf.BladePetal, pose="similarity", loss="robust", throw=False
    )
    members = result.weights > 0.5
    assert members[:2000].mean() > 0.93
    assert members[2000:].mean() < 0.02
    assert result.traits["length"].value == pytest.approx(40, rel=0.04)
    assert result.traits["width"].value == pytest.approx(20, rel=0.04)
    assert "lie on a flat table or a round stalk" in " ".join(map(str, result.warnings))
