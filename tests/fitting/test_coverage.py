"""What a surface has no points near: hidden parts are legitimate, another outline is a misfit."""

import jax
import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.inference.coverage import Coverage, Rim
from petalfit.fitting.outliers.local_planes import on_sheets
from tests.fitting.conftest import noisy_cloud


def covered(model, points):
    with jax.enable_x64(True):
        found = Coverage.of(model, points)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def points():
    return np.asarray(pf.Rectangle(a_x=10.0, b_y=20.0).sample(2000, seed=1, noise=0.05).points)


def test_all_of_it(points):
    assert covered(pf.Rectangle(a_x=10.0, b_y=20.0), points) == (0.0, 0.0, 0.0, 0.0)


def test_one_part_is_hidden(points):
    half = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points[points[:, 1] < 10])
    assert half.area == pytest.approx(0.45, abs=0.03)
    assert half.outline == pytest.approx(0.45, abs=0.04)
    assert half.scattered == 0.0


def test_a_hole_is_not_in_the_outline(points):
    around = np.linalg.norm(points - [0, 10, 0], axis=1) > 3
    hole = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points[around])
    assert 0.04 < hole.area < 0.14
    assert hole.outline == 0.0


def test_the_corners_are_missing(points):
    inside = (points[:, 0] / 5) ** 2 + ((points[:, 1] - 10) / 10) ** 2 < 1
    ellipse = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points[inside])
    assert ellipse.outline > 0.3
    assert ellipse.scattered > 0.2


def test_points_too_few_to_tell(points):
    with jax.enable_x64(True):
        assert Coverage.of(pf.Rectangle(a_x=10.0, b_y=20.0), points[:49]) is None


def test_a_closed_surface_has_no_outline():
    tube = pf.Cylinder(r=3.0, h=20.0)
    points = np.asarray(tube.sample(2000, seed=2).points)
    assert covered(tube, points[points[:, 0] < 0])[1:] == (0.0, 0.0, 0.0)


def test_points_go_on_beyond_the_outline(points):
    narrow = covered(pf.Rectangle(a_x=5.0, b_y=20.0), points)
    assert narrow.crossed == pytest.approx(40 / 50, abs=0.05)
    assert narrow.outline == 0.0


def test_stretches_go_around():
    angle = 2 * np.pi * np.arange(100) / 100
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    rim = Rim(circle, circle, np.full(100, 0.01))
    bare = np.zeros(100, bool)
    bare[[98, 99, 0, 1, 2, 50, 51]] = True
    assert sorted(rim.stretches(bare)) == pytest.approx([0.02, 0.05])
    assert rim.stretches(~np.zeros(100, bool)) == [1.0]
    assert rim.stretches(np.zeros(100, bool)) == []


def test_a_star_is_no_petal_and_tells_nothing_of_one():
    rng = np.random.default_rng(1)
    flat = rng.uniform(-1, 1, (6000, 2))
    radius, angle = np.hypot(*flat.T), np.arctan2(flat[:, 1], flat[:, 0])
    flat = flat[radius < 0.65 + 0.35 * np.cos(5 * angle)][:1500]
    points = 10 * np.column_stack([flat[:, 0], flat[:, 1] + 1, 0 * flat[:, 0]])
    result = pf.fit_petal(points + rng.normal(scale=0.05, size=points.shape), throw=False)
    assert result.status == "misfit"
    assert "of its outline has no points near it" in result.reason
    assert not any(result.identifiable.values())
    assert result.posterior is None


def test_what_eleven_points_determine_of_ten_parameters_is_true():
    """The noise is estimated from a single degree of freedom, so that the errors are wide."""
    petal, off = pf.PeonyPetal(), []
    for seed in (0, 1, 5, 7):
        points, _ = noisy_cloud(petal, 11, 0.05, np.random.default_rng(seed))
        result = pf.fit_petal(points, throw=False)
        off += [
            (result.values[name] - getattr(petal, name)) / result.stderr[name]
            for name in result.names
            if result.converged and result.identifiable[name]
        ]
    assert np.mean(np.abs(off) < 1.96) > 0.9


def test_a_sheet_around_a_ball_is_no_petal():
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(1200, 3))
    ball *= 10 / np.linalg.norm(ball, axis=1, keepdims=True)
    result = pf.fit_petal(ball, model=pf.SplinePetal, pose="similarity", throw=False)
    assert result.status == "misfit"


def test_a_part_that_was_scanned_less_densely_is_no_clutter():
    rng = np.random.default_rng(3)
    dense, sparse = rng.uniform(0, 10, (900, 2)), rng.uniform([10, 0], [30, 20], (900, 2))
    flat = np.concatenate([dense, sparse])
    sheet = np.column_stack([flat, 0.05 * flat[:, 0] ** 2 + rng.normal(0, 0.02, len(flat))])
    # With two densities taken for sheet and clutter, half of them would be left.
    assert np.mean(on_sheets(sheet)) > 0.7
    clutter = rng.uniform(sheet.min(axis=0) - 2, sheet.max(axis=0) + 2, (400, 3))
    found = on_sheets(np.concatenate([sheet[:900], clutter]))
    assert np.mean(found[:900]) > 0.95
    assert np.mean(found[900:]) < 0.3
