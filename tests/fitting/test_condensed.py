"""A large cloud, condensed to cells: the same likelihood, and the same answer, as with all points."""

import jax
import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

import petalfit as pf
from petalfit.fitting.likelihood import condensed_cloud
from petalfit.fitting.likelihood.cells import Cells, condense
from petalfit.fitting.likelihood.condensed_sheet import COARSE, ENOUGH, FINE, CondensedSheet
from petalfit.fitting.likelihood.relief import Relief, beside_many
from petalfit.fitting.likelihood.sheet import Sheet
from petalfit.fitting.solver.descent import Descent

BLADE = pf.BladePetal(length=2.0, width=0.7, bend=0.9, cup_mid=0.5, twist=0.2, tip_roll=0.3)
FREE = ("length", "width", "widest", "tip_width", "tip_taper", "bend", "cup_mid", "twist")
NOISE = 0.003


def cloud(count: int, seed: int = 0) -> np.ndarray:
    """Points spread evenly over the blade, with noise."""
    points, _ = trimesh.sample.sample_surface(BLADE.mesh((257, 257)), count, seed=seed)
    return np.asarray(points) + np.random.default_rng(seed).normal(0, NOISE, (count, 3))


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return cloud(20_000)


def test_foot_points_are_the_nearest_places(points):
    # The oracle: the nearest vertex of a fine mesh is hardly farther than the foot point.
    fine = np.asarray(BLADE.mesh((801, 801)).vertices)
    nearest = np.asarray(KDTree(fine).query(points)[0])
    with jax.enable_x64(True):
        near = Relief.of(BLADE).located(points)
        exact = np.asarray(BLADE(near.uv[:, 0], near.uv[:, 1]), float)
    away = np.linalg.norm(points - near.place, axis=1)
    assert np.abs(exact - near.place).max() < 1e-6
    assert np.quantile(away - nearest, 0.999) < 1e-9
    assert np.all(nearest - away < 0.003)


def test_distances_are_those_of_the_search_point_by_point(points):
    some = points[:3000] + np.random.default_rng(2).normal(0, 0.015, (3000, 3))
    with jax.enable_x64(True):
        fast = beside_many(BLADE, some)
        sheet = Sheet(some, np.ones(len(some)))
        slow = sheet.beside(BLADE, sheet.nearest(BLADE))
    assert np.quantile(np.abs(fast[0] - slow[0]), 0.99) < 1e-6
    outside = slow[1] > 0
    assert np.count_nonzero(outside) > 30
    assert np.mean((fast[1] > 0) == outside) > 0.999
    assert np.quantile(np.abs(fast[1] - slow[1])[outside], 0.9) < 1e-5


@pytest.mark.parametrize(("cells", "error"), [(FINE, 0.05), (COARSE, 0.4)])
def test_the_cost_changes_as_that_of_all_points(points, cells, error):
    with jax.enable_x64(True):
        sheet = Sheet(points, np.ones(len(points)))
        made = Descent.of(BLADE, FREE, sheet, NOISE)
        here = made.start(BLADE)
        spread = 1 / np.sqrt(np.diag(here.information))
        few = CondensedSheet.of(sheet, BLADE, 1.1 * NOISE, cells)
        other = Descent.of(BLADE, FREE, few, NOISE)
        for seed in range(3):
            step = np.random.default_rng(seed).normal(size=len(spread)) * spread
            step[-2:] = 0.0
            all_of, condensed = (one.evaluate_anywhere(here.z + step) for one in (made, other))
            wrong = np.linalg.solve(all_of.information, all_of.gradient - condensed.gradient)
            errors = np.sqrt(np.diag(np.linalg.inv(all_of.information)))
            assert np.all(np.abs(wrong) < error * errors)
            ratio = np.diag(condensed.information) / np.diag(all_of.information)
            assert np.all(np.abs(ratio - 1) < 0.05)


def test_weights_and_squares_are_kept(points):
    weights = np.random.default_rng(1).uniform(0.0, 2.0, len(points))
    weights[:5000] = 0.0
    with jax.enable_x64(True):
        few = CondensedSheet.of(Sheet(points, weights), BLADE, NOISE, FINE)
        kept = CondensedSheet.of(Sheet(points[5000:], weights[5000:]), BLADE, NOISE, FINE)
    assert few.weights.sum() == pytest.approx(weights.sum(), rel=1e-12)
    assert few.points == pytest.approx(kept.points)
    assert few.scattered == pytest.approx(kept.scattered)
    assert len(few.points) < len(points) / 2
    # Most points stand for others, so that nearly the whole variance of the noise is scattered.
    assert 0.3 * NOISE**2 < few.scattered / weights.sum() < 1.1 * NOISE**2


def test_bands_follow_the_edges():
    cells = Cells(10, 10, 0.5)
    with jax.enable_x64(True):
        relief = Relief.of(pf.Rectangle(a_x=2.0, b_y=4.0))
        inside = np.column_stack([np.linspace(-0.99, 0.99, 199), np.full(199, 2.0), np.zeros(199)])
        numbers, _ = cells.sorted(relief, relief.located(inside), 0.01)
    columns = np.unravel_index(numbers, cells.shape)[0]
    assert len(np.unique(columns)) > 10
    # Far from the edges there are the ten cells alone.
    assert set(columns[20:-20]) <= set(range(10))


def test_a_large_cloud_gives_the_numbers_of_every_point():
    points = cloud(6000, 3)
    assert len(points) > ENOUGH
    few = pf.fit(pf.BladePetal, points, pose="similarity")
    every = pf.fit(pf.BladePetal, points, pose="similarity", every_point=True)
    assert few.points_used["residuals"] == 6000
    assert few.points_used["last steps"] < 6000
    assert every.points_used == {}
    assert len(few.agreements[0].distances) == 6000
    assert few.rms == pytest.approx(every.rms, rel=1e-3)
    for name in few.names:
        if few.identifiable[name]:
            away = abs(few.values[name] - every.values[name])
            assert away < 0.3 * every.stderr[name]


@pytest.mark.parametrize("surface", [BLADE, pf.PeonyPetal(), pf.Ellipsoid()])
def test_normals_are_those_of_the_surface(surface):
    uv = np.random.default_rng(0).uniform(*np.array(surface.domain).T, (50, 2))
    with jax.enable_x64(True):
        place, normal = Relief.of(surface).at(uv)
        expected = surface.normal(uv[:, 0], uv[:, 1])
        at = surface(uv[:, 0], uv[:, 1])
    assert place == pytest.approx(np.asarray(at), abs=2e-3)
    assert np.median(np.sum(normal * np.asarray(expected), axis=1)) > 0.999


def test_a_cell_keeps_the_squares_across_it():
    # The potential of an edge bends within a band: one point at the mean would lose that.
    rectangle, rng = pf.Rectangle(a_x=2.0, b_y=4.0), np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(-1, 1, 40_000), rng.uniform(0, 4, 40_000), np.zeros(40_000)]
    ) + rng.normal(0, 0.02, (40_000, 3))
    with jax.enable_x64(True):
        few = condense(points, np.ones(40_000), rectangle, 0.02, Cells(20, 20, 0.5))
    assert len(few.points) < 8000
    for column in range(3):
        exact = np.sum(points[:, column] ** 2)
        assert few.weights @ few.points[:, column] == pytest.approx(points[:, column].sum())
        if column == 0:
            assert few.weights @ few.points[:, 0] ** 2 == pytest.approx(exact, rel=3e-4)
    assert few.squares == pytest.approx(np.sum(points[:, 2] ** 2))


def test_a_large_cloud_of_a_peony_petal_gives_the_numbers_of_every_point():
    points = pf.PeonyPetal().sample(condensed_cloud.ENOUGH + 1, seed=1, noise=0.05)
    few = pf.fit_petal(points)
    every = pf.fit_petal(points, every_point=True)
    assert few.points_used["residuals"] == len(points)
    assert few.points_used["last steps"] < len(points) / 4
    assert few.rms == pytest.approx(every.rms, rel=1e-3)
    for name in few.names:
        # Where the petal folds over its base, and at its crest, a few foot points differ.
        assert abs(few.values[name] - every.values[name]) < 0.6 * every.stderr[name]
        # What edges say is measured by the squares of a few hundred points' scores.
        assert few.stderr_noise[name] == pytest.approx(every.stderr_noise[name], rel=0.15)


def test_outliers_are_found_in_a_large_cloud():
    points, rng = cloud(9000, 4), np.random.default_rng(5)
    clutter = rng.uniform(points.min(axis=0), points.max(axis=0), (1500, 3))
    result = pf.fit(
        pf.BladePetal, np.concatenate([points, clutter]), pose="similarity", loss="robust"
    )
    weights = result.agreements[0].weights
    assert weights[:9000].mean() > 0.97
    assert weights[9000:].mean() < 0.2


def test_outliers_are_found_in_a_large_cloud_of_a_peony_petal():
    points = pf.PeonyPetal().sample(25_000, seed=2, noise=0.05).points
    low, high = points.min(axis=0), points.max(axis=0)
    clutter = np.random.default_rng(6).uniform(low, high, (6000, 3))
    result = pf.fit_petal(np.concatenate([points, clutter]), loss="robust")
    weights = result.agreements[0].weights
    assert weights[:25_000].mean() > 0.97
    assert weights[25_000:].mean() < 0.2
    true = pf.PeonyPetal()
    z = [(result.values[n] - getattr(true, n)) / result.stderr[n] for n in result.stderr]
    assert np.max(np.abs(z)) < 4


def test_every_point_is_refused_where_it_has_no_meaning():
    with pytest.raises(pf.TargetError, match="every_point"):
        pf.fit(pf.SplinePetal, cloud(500), pose="similarity", every_point=True)
    with pytest.raises(pf.TargetError, match="every_point"):
        pf.fit("auto", cloud(500), pose="similarity", every_point=True)
