"""Traits of fits: values, errors and units."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from jaxtyping import Array

import petalfit as pf
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


def test_a_spline_has_values_without_errors():
    found = pf.fit_petal(PETAL.sample(1500, seed=1), model=pf.SplinePetal)
    assert found.traits["area"].value == pytest.approx(found.mesh((129, 129)).area, rel=1e-3)
    assert np.isinf(found.traits["area"].stderr)


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
