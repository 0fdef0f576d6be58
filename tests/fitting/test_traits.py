"""Traits of fits: values, errors and units."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from jaxtyping import Array

import petalfit as pf
from petalfit.fitting.families.spline.margin import gap
from petalfit.surfaces import Scalar, number

PETAL = pf.PeonyPetal()


@pytest.fixture(scope="module")
def known() -> pf.FitResult:
    return pf.fit_petal(PETAL.sample(1500, seed=0, noise=0.03))


def test_values_are_those_of_the_surface(known):
    mesh = known.mesh((257, 257))
    assert known.traits["area"].value == pytest.approx(mesh.area, rel=2e-3)
    grid = np.asarray(known.model(np.zeros(4001), np.linspace(0, 1, 4001)), float)
    length = np.linalg.norm(np.diff(grid, axis=0), axis=-1).sum()
    assert known.traits["length"].value == pytest.approx(length, rel=1e-3)
    traits = known.traits
    assert traits["length_to_width"].value == pytest.approx(
        traits["length"].value / traits["width"].value
    )


def test_errors_follow_from_the_covariance_by_finite_differences(known):
    names, step = known.posterior.names, 1e-3
    spread = {n: np.ptp(known.declared[n].typical) / 12**0.5 for n in names}

    def area(name: str, side: int) -> float:
        moved = {name: float(getattr(known.model, name)) + side * step * spread[name]}
        return dataclasses.replace(known.model, **moved).mesh((257, 257)).area

    slopes = [(area(n, 1) - area(n, -1)) / (2 * step * spread[n]) for n in names]
    expected = np.sqrt(slopes @ known.posterior.covariance @ slopes)
    assert known.traits["area"].stderr == pytest.approx(expected, rel=0.03)


def test_errors_have_the_size_of_the_deviations():
    true = np.asarray(PETAL(np.zeros(8001), np.linspace(0, 1, 8001)), float)
    length = np.linalg.norm(np.diff(true, axis=0), axis=-1).sum()
    found = [
        pf.fit_petal(PETAL.sample(400, seed=s, noise=0.05)).traits["length"] for s in range(12)
    ]
    z = np.array([(trait.value - length) / trait.stderr for trait in found])
    # The mean square of twelve normal deviates lies outside of these limits once in 500 times.
    assert 0.18 < np.mean(z**2) < 2.74


def test_they_have_the_scans_unit_whatever_the_pose(known):
    cloud = PETAL.sample(1500, seed=0, noise=0.03)
    turn = trimesh.transformations.rotation_matrix(1.0, [1, 2, 3])[:3, :3]
    found = pf.fit_petal(25.4 * cloud.points @ turn.T + 7.0, pose="similarity")
    for name, trait in known.traits.items():
        factor = {"unit": 25.4, "unit²": 25.4**2}.get(trait.unit, 1.0)
        tolerance = 4 * np.hypot(found.traits[name].stderr, factor * trait.stderr)
        assert found.traits[name].value == pytest.approx(factor * trait.value, abs=tolerance + 1e-9)
    assert found.traits["length"].stderr < 0.05 * found.traits["length"].value


def test_they_are_in_the_file(known, tmp_path):
    known.save(tmp_path / "fit.json")
    assert pf.FitResult.load(tmp_path / "fit.json").traits == known.traits


@pytest.fixture(scope="module")
def spline() -> pf.FitResult:
    return pf.fit_petal(PETAL.sample(1500, seed=1, noise=0.03), model=pf.SplinePetal)


def test_a_spline_has_an_error_of_its_area_alone(spline, tmp_path):
    assert spline.traits["area"].value == pytest.approx(spline.mesh((129, 129)).area, rel=1e-3)
    known = {name for name, trait in spline.traits.items() if np.isfinite(trait.stderr)}
    assert known == {"area"}
    assert 0 < spline.traits["area"].stderr < 0.05 * spline.traits["area"].value
    spline.save(tmp_path / "fit.json")
    assert pf.FitResult.load(tmp_path / "fit.json").traits == spline.traits


def dish() -> pf.SplinePetal:
    offsets, x = np.zeros((10, 10, 3)), np.linspace(-1, 1, 10)
    offsets[..., 2] = 1.5 * x**2 + 0.8 * x[:, None] ** 2
    return pf.SplinePetal(a_x=6.0, b_y=10.0, offsets=offsets)


def test_areas_of_splines_deviate_as_much_as_their_errors_say():
    """Without the gap between points and margin, every one of them would be too small."""
    area = dish().mesh((257, 257)).area
    found = [
        pf.fit_petal(dish().sample(1000, seed=s, noise=0.01), model=pf.SplinePetal)
        for s in range(8)
    ]
    traits = [fit.traits["area"] for fit in found]
    z = np.array([(trait.value - area) / trait.stderr for trait in traits])
    # The mean square of eight normal deviates lies outside of these limits once in 500 times.
    assert 0.11 < np.mean(z**2) < 3.1
    assert abs(np.mean(z)) < 1.1
    assert all(trait.stderr < 0.02 * area for trait in traits)


def uneven(seed: int) -> pf.SplinePetal:
    """A sheet with an irregular margin and relief."""
    i, j = np.meshgrid(np.linspace(-1, 1, 10), np.linspace(0, 1, 10), indexing="ij")
    rng = np.random.default_rng(seed)
    offsets = 0.36 * rng.standard_normal((10, 10, 3))
    offsets[..., 2] += 0.8 * i**2 + 1.5 * j**2 * rng.uniform(-1, 1)
    offsets[..., 0] -= 6.0 * i * (j - 0.5) ** 2
    offsets[..., 1] -= 4.0 * i**2 * (j - 0.4)
    return pf.SplinePetal(a_x=6.0, b_y=10.0, offsets=offsets)


@pytest.mark.slow
def test_intervals_of_areas_of_splines_hold_them():
    held = []
    for seed in range(100):
        sheet = uneven(seed // 10)
        points = sheet.sample(2000, seed=seed, noise=0.012).points
        trait = pf.fit_petal(points, model=pf.SplinePetal, pose="similarity").traits["area"]
        held.append(abs(trait.value - sheet.mesh((257, 257)).area) < 1.96 * trait.stderr)
    assert np.mean(held) >= 0.88


def test_a_hole_does_not_make_a_spline_bulge():
    points = dish().sample(3000, seed=0, noise=0.01).points
    away = np.hypot(points[:, 0] / 3, (points[:, 1] - 5) / 5)
    found = pf.fit_petal(points[away > 0.6], model=pf.SplinePetal).traits["area"]
    assert found.value == pytest.approx(dish().mesh((257, 257)).area, rel=0.01)


def test_the_gap_is_that_of_a_known_margin_and_none_where_points_lie_on_it():
    # 20 points, each of which covers 0.01, hold edges of length 10.
    inside = -np.random.default_rng(0).uniform(0.0, 5.0, 5000)
    beyond = np.concatenate([np.linspace(0.001, 0.04, 20), inside])
    outside, holding = gap(beyond, noise=1e-3, spacing=0.1, perimeter=10.0)
    assert holding == 20
    assert outside == pytest.approx(0.02, abs=1e-3)
    on_the_margin = np.concatenate([np.full(100, 1e-6), np.full(100, -1e-6), inside])
    assert gap(on_the_margin, noise=1e-3, spacing=0.1, perimeter=10.0)[0] == 0.0


def test_what_is_no_sheet_has_none():
    assert pf.fit(pf.Cylinder, pf.Cylinder().sample(400, seed=0)).traits == {}


class Board(pf.AbstractSurface):
    """A rectangle twice as long as wide, whose own parameter has the name of a pose's."""

    scale: Scalar = number(3.0, "s", (0.5, 20.0), (1.0, 9.0), "its width")
    domain: ClassVar[pf.Domain] = pf.Rectangle.domain

    def position(self, u: Array, v: Array) -> Array:
        return self.scale * jnp.stack([u, 2 * v, 0.1 * u * v], axis=-1)


def test_a_parameter_called_scale_is_no_pose():
    found = pf.fit(Board, Board(scale=4.0).sample(800, seed=0, noise=0.02))
    assert found.posterior.names == ("scale",)
    assert found.traits["length"].value == pytest.approx(2 * found.values["scale"], rel=1e-6)
    assert found.traits["length"].stderr == pytest.approx(2 * found.stderr["scale"], rel=1e-3)
