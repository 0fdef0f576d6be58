"""What a surface has no points near: hidden parts are legitimate, another outline is a misfit."""

import dataclasses
import importlib

import jax
import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.inference.coverage import Coverage, Rim, deepest_bay
from petalfit.fitting.inference.turns import alone_when_turned
from petalfit.fitting.inference.verdict import misfit_of_bays, misfit_of_outline, misfit_of_turns
from petalfit.fitting.outliers.local_planes import on_sheets
from petalfit.fitting.run import run
from petalfit.results import Agreement
from petalfit.synthetic import random_petal

from .conftest import noisy_cloud, random_blade

# The module, which the function of the same name hides in its package.
fit = importlib.import_module("petalfit.fitting.fit")


def covered(model, points):
    with jax.enable_x64(True):
        found = Coverage.of(model, points)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def points():
    return np.asarray(pf.Rectangle(a_x=10.0, b_y=20.0).sample(2000, seed=1, noise=0.05).points)


def test_all_of_it(points):
    whole = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points)
    assert whole._replace(loose=0.0, bay=0.0) == (0.0,) * 8
    assert whole.loose < 0.1
    assert whole.bay < 0.01


def test_one_part_is_hidden(points):
    half = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points[points[:, 1] < 10])
    assert half.area == pytest.approx(0.45, abs=0.03)
    assert half.outline == pytest.approx(0.45, abs=0.04)
    assert half.scattered == half.hole == 0.0


def test_two_parts_are_hidden(points):
    middle = points[np.abs(points[:, 1] - 10) < 7]
    found = covered(pf.Rectangle(a_x=10.0, b_y=20.0), middle)
    assert found.outline == pytest.approx(2 * 14 / 60, abs=0.07)
    assert found.scattered == 0.0


def test_a_hole_is_not_in_the_outline(points):
    around = np.linalg.norm(points - [0, 10, 0], axis=1) > 3
    hole = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points[around])
    assert 0.04 < hole.area < 0.14
    assert hole.hole == hole.area
    assert hole.outline == 0.0


def test_the_corners_are_missing(points):
    inside = (points[:, 0] / 5) ** 2 + ((points[:, 1] - 10) / 10) ** 2 < 1
    ellipse = covered(pf.Rectangle(a_x=10.0, b_y=20.0), points[inside])
    assert ellipse.outline > 0.3
    # Four corners alike, two of which might be hidden.
    assert ellipse.scattered == pytest.approx(0.5 * ellipse.outline, rel=0.2)
    assert ellipse.loose > 0.4


def test_points_too_few_to_tell(points):
    with jax.enable_x64(True):
        assert Coverage.of(pf.Rectangle(a_x=10.0, b_y=20.0), points[:49]) is None


def test_a_closed_surface_has_no_outline():
    tube = pf.Cylinder(r=3.0, h=20.0)
    points = np.asarray(tube.sample(2000, seed=2).points)
    assert covered(tube, points[points[:, 0] < 0])[1:] == (0.0,) * 7


def test_points_go_on_beyond_the_outline(points):
    narrow = covered(pf.Rectangle(a_x=5.0, b_y=20.0), points)
    assert narrow.crossed == pytest.approx(40 / 50, abs=0.05)
    assert narrow.outline == 0.0


def test_a_surface_that_turns_back_on_itself_is_folded():
    flat = pf.SplinePetal(a_x=10.0, b_y=20.0)
    points = np.asarray(flat.sample(500, seed=3).points)
    assert covered(flat, points).folded == 0.0
    offsets = np.zeros(np.shape(flat.offsets))
    offsets[: len(offsets) // 2, :, 0] = np.linspace(0.8, 0.0, len(offsets) // 2)[:, None] * 30.0
    folded = pf.SplinePetal(a_x=10.0, b_y=20.0, offsets=offsets)
    assert covered(folded, points).folded > 0.005


def test_stretches_go_around():
    angle = 2 * np.pi * np.arange(100) / 100
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    rim = Rim(circle, circle, np.full(100, 0.01))
    bare = np.zeros(100, bool)
    bare[[98, 99, 0, 1, 2, 50, 51]] = True
    assert sorted(rim.stretches(bare)) == pytest.approx([0.02, 0.05])
    assert rim.stretches(~np.zeros(100, bool)) == [1.0]
    assert rim.stretches(np.zeros(100, bool)) == []


def flat_points(shape):
    """1,500 noisy points of a flat shape that is 20 wide, given by polar coordinates of its places."""
    rng = np.random.default_rng(1)
    flat = rng.uniform(-1, 1, (12000, 2))
    flat = flat[shape(np.hypot(*flat.T), np.arctan2(flat[:, 1], flat[:, 0]))][:1500]
    points = 10 * np.column_stack([flat[:, 0], flat[:, 1] + 1, 0 * flat[:, 0]])
    return points + rng.normal(scale=0.05, size=points.shape)


def star(radius, angle):
    return radius < 0.65 + 0.35 * np.cos(5 * angle)


def plus(radius, angle):
    return radius * np.minimum(np.abs(np.cos(angle)), np.abs(np.sin(angle))) < 0.3


def test_a_star_is_no_petal_and_tells_nothing_of_one():
    result = pf.fit_petal(flat_points(star), throw=False)
    assert result.status == "misfit"
    assert "of its outline has no points near it" in result.reason
    assert not any(result.identifiable.values())
    assert result.posterior is None


@pytest.mark.parametrize("loss", ["linear", "robust"])
def test_a_plus_is_no_blade(loss):
    result = pf.fit_petal(
        flat_points(plus), model=pf.BladePetal, pose="similarity", loss=loss, throw=False
    )
    assert result.status == "misfit"


@pytest.mark.parametrize(
    ("outline", "crossed", "in_space", "said"),
    [
        (0.48, 0.02, True, ""),  # half of a petal
        (0.15, 0.15, True, ""),  # a whole one that the model follows badly
        (0.53, 0.04, True, "another shape"),  # an L
        (0.25, 0.18, True, "beyond 18 % of it"),  # a square
        (0.12, 0.22, True, "beyond 22 % of its outline"),  # another one
        (0.55, 0.02, False, ""),  # a little less than half of a petal, whose pose is known
        (0.62, 0.00, False, "another shape"),  # a square as its middle
    ],
)
def test_an_outline_that_is_not_the_petals(outline, crossed, in_space, said):
    part = Agreement(pf.PointCloud(flat_points(plus)), np.zeros(1500), np.ones(1500), 0.05)
    seen = Coverage(
        area=0.0,
        outline=outline,
        scattered=0.0,
        crossed=crossed,
        hole=0.0,
        loose=0.0,
        folded=0.0,
        bay=0.0,
    )
    reason = misfit_of_outline(part, seen, 0.0, is_free=False, in_space=in_space)
    assert said in reason
    assert bool(said) == bool(reason)


def test_a_surface_that_leaves_all_points_is_a_misfit():
    """A robust fit whose blade slips out of a ring, where no point seems to belong to it any more."""
    rng = np.random.default_rng(1)
    angle, radius = rng.uniform(0, 2 * np.pi, 600), 10 * np.sqrt(rng.uniform(0.36, 1, 600))
    height = rng.normal(0, 0.02, 600)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    result = pf.fit_petal(ring, model=pf.BladePetal, loss="robust", throw=False)
    assert result.status == "misfit"


@pytest.mark.parametrize("model", [pf.BladePetal, pf.SplinePetal])
def test_a_ring_is_no_petal(model):
    ring = flat_points(lambda radius, angle: (radius < 1) & (radius > 0.75))
    result = pf.fit_petal(ring, model=model, pose="similarity", throw=False)
    assert result.status == "misfit"
    assert "hole" in result.reason


@pytest.mark.parametrize("shape", [star, plus])
def test_no_spline_surface_has_the_outline_of(shape):
    result = pf.fit_petal(flat_points(shape), model=pf.SplinePetal, throw=False)
    assert result.status == "misfit"
    assert "bay" in result.reason or "fold back" in result.reason


def test_a_spline_surface_is_an_ellipse_and_measures_its_area():
    ellipse = flat_points(lambda radius, angle: radius < 1) * [0.6, 1, 1]
    result = pf.fit_petal(ellipse, model=pf.SplinePetal)
    area = result.traits["area"]
    assert abs(area.value - 60 * np.pi) < 1.96 * area.stderr < 6


@pytest.mark.parametrize("bend", [0.0, 1.2])
@pytest.mark.parametrize("depth", [0.0, 0.3, 0.8])
def test_a_bay_is_as_deep_as_its_notch(bend, depth):
    """A sheet, 2 wide and 3 long, with a notch in its end, is bent around a cylinder along the y axis."""
    x, y = np.meshgrid(np.linspace(-1, 1, 25), np.linspace(0, 1, 33), indexing="ij")
    y = y * (3 - depth * (1 - np.abs(x)))
    grid = np.stack([x, y, 0 * x], axis=-1)
    if bend:
        grid = np.stack([np.sin(bend * x) / bend, y, (1 - np.cos(bend * x)) / bend], axis=-1)
    # Ways around the bottom of a deep notch are longer than straight ones, so that it seems less deep.
    exact = depth / np.hypot(2, 3)
    assert deepest_bay(grid) == pytest.approx(exact - exact**2, abs=0.015)


def crescent(radius, angle):
    return (radius < 1) & (np.hypot(radius * np.cos(angle) - 0.5, radius * np.sin(angle)) > 0.8)


def hourglass(radius, angle):
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return (np.abs(y) < 0.9) & (np.abs(x) < 0.2 + 0.7 * np.abs(y))


@pytest.mark.parametrize("model", [pf.BladePetal, pf.SplinePetal])
@pytest.mark.parametrize("shape", [crescent, hourglass])
def test_a_petal_has_no_bay_as_deep_as_a(shape, model):
    points = flat_points(shape)
    result = pf.fit_petal(points, model=model, pose="similarity", throw=False)
    assert result.status == "misfit"
    assert "bay" in result.reason


@pytest.mark.parametrize("model", [pf.BladePetal, pf.SplinePetal, pf.PeonyPetal])
def test_a_disc_is_no_petal(model):
    points = flat_points(lambda radius, angle: radius < 1)
    result = pf.fit_petal(points, model=model, pose="similarity", throw=False)
    assert result.status == "misfit"
    assert not any(result.identifiable.values())


@pytest.mark.parametrize("count", [300, 1500])
@pytest.mark.parametrize(
    "shape",
    [
        lambda radius, angle: radius < 1,
        lambda radius, angle: (radius < 1) & (radius > 0.7),
        lambda radius, angle: np.maximum(np.cos(angle) ** 2, np.sin(angle) ** 2) * radius**2 < 0.5,
        plus,
        star,
    ],
    ids=["disc", "ring", "square", "plus", "star"],
)
def test_a_turn_leaves_the_same(shape, count):
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    assert misfit_of_turns(flat_points(shape)[:count] @ turn + [3.0, 1.0, 100.0])


def test_a_turn_leaves_a_closed_body_the_same():
    rng = np.random.default_rng(4)
    ball = rng.normal(size=(1500, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert alone_when_turned(ball) < 0.02
    assert alone_when_turned(ball[ball[:, 2] > 0]) < 0.02


@pytest.mark.parametrize("draw", [random_petal, random_blade])
def test_no_turn_leaves_a_petal_the_same(draw):
    for seed in range(40):
        rng = np.random.default_rng(seed)
        model = draw(rng)
        points = np.asarray(model.sample(int(rng.choice([300, 1500])), seed=seed).points)
        size = np.linalg.norm(np.ptp(points, axis=0))
        assert not misfit_of_turns(points + rng.normal(scale=0.002 * size, size=points.shape))
        assert not misfit_of_bays(covered(model, points))


def test_few_points_are_not_turned():
    assert alone_when_turned(flat_points(lambda radius, angle: radius < 1)[:100]) == 1.0


@pytest.mark.parametrize("loss", ["linear", "robust"])
@pytest.mark.parametrize("of", ["torus", "tube", "crossed"])
def test_a_spline_surface_is_one_sheet(of, loss):
    rng = np.random.default_rng(3)
    u, v = rng.uniform(-np.pi, np.pi, (2, 1200))
    across, level, first = 10 + 3 * np.cos(v), 0 * u, rng.random(1200) < 0.5
    points = {
        "torus": np.stack([across * np.cos(u), across * np.sin(u), 3 * np.sin(v)]),
        "tube": np.stack([4 * np.cos(u), 4 * np.sin(u), 3 * v]),
        "crossed": np.where(
            first, np.stack([3 * u, level, 3 * v]), np.stack([level, 3 * u, 3 * v])
        ),
    }[of].T
    points = points + rng.normal(scale=0.05, size=points.shape)
    result = pf.fit_petal(points, model=pf.SplinePetal, loss=loss, throw=False)
    assert result.status == "misfit"


def test_a_fit_that_still_moves_is_less_sure(monkeypatch):
    points = np.asarray(pf.PeonyPetal().sample(600, seed=1, noise=0.05).points)
    ended = pf.fit_petal(points)

    def stopped(*args):
        request, ends = run(*args)
        return request, [dataclasses.replace(ends[0], moved=7.0), *ends[1:]]

    monkeypatch.setattr(fit, "run", stopped)
    result = pf.fit_petal(points, throw=False)
    assert result.status == "round_limit"
    both = [n for n in result.names if result.identifiable[n]]
    assert 3 < len(both) < sum(ended.identifiable.values())
    factors = [result.stderr[n] / ended.stderr[n] for n in both]
    assert factors == pytest.approx(np.full(len(both), np.sqrt(50)), rel=0.1)


@pytest.mark.parametrize(("moved", "status"), [(1.0, "misfit"), (7.0, "round_limit")])
def test_an_end_that_hardly_moves_is_judged_by_its_outline(moved, status, monkeypatch):
    def stopped(*args):
        request, ends = run(*args)
        return request, [dataclasses.replace(ends[0], moved=moved), *ends[1:]]

    monkeypatch.setattr(fit, "run", stopped)
    # No turn leaves a narrow star the same, which would tell in any case.
    narrow = flat_points(star) * [0.7, 1, 1]
    assert pf.fit_petal(narrow, throw=False).status == status


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
