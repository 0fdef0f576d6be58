"""Organs of several surfaces: where their parts stand, and that they are fitted as a whole."""

import jax
import numpy as np
import pytest

import petalfit as pf
from petalfit.surfaces import value_at, with_value

STAMEN = pf.Stamen(
    pf.Filament(r=0.6, h=18.0, a_2=4.0, taper=0.2), pf.Anther(r=1.2, swell=0.8), tilt=0.7
)
PISTIL = pf.Pistil(pf.Ovary(r=3.0), pf.Style(r=1.0, swell=0.3, bend=1.0), pf.Stigma(r=2.0, h=1.0))
ORGANS = {
    "stamen": STAMEN,
    "pistil": PISTIL,
    "compound": pf.CompoundPistil(PISTIL, spread=0.7, carpels=2),
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", ORGANS)
def test_the_atlas_has_every_part_where_it_stands(name):
    organ = ORGANS[name]
    rng = np.random.default_rng(0)
    for k, (pose, surface) in enumerate(organ.parts().values()):
        low, high = np.array(surface.domain).T
        uv = low + (high - low) * rng.random((40, 2))
        expected = np.asarray(pose(surface(*uv.T)))
        np.testing.assert_allclose(organ.part(k)(*uv.T), expected, atol=1e-12)
        np.testing.assert_allclose(organ(*organ.in_atlas(k, uv).T), expected, atol=1e-9)
        # Edges too, which must not become the next part's.
        corners = np.array([low, high, [low[0], high[1]], [high[0], low[1]]])
        expected = np.asarray(pose(surface(*corners.T)))
        np.testing.assert_allclose(organ(*organ.in_atlas(k, corners).T), expected, atol=1e-9)


def test_parts_follow_one_another():
    parts = {name: pose.translation for name, (pose, _) in PISTIL.parts().items()}
    assert parts["ovary"][1] == pytest.approx(6.0)  # it stands on its base
    with jax.enable_x64(True):
        top = np.asarray(PISTIL.part(1)(np.linspace(0, 6, 9), 1.0)).mean(axis=0)
    np.testing.assert_allclose(top[1], parts["stigma"][1])
    higher = with_value(PISTIL, "ovary.r", 4.0).parts()
    assert higher["stigma"][0].translation[1] == pytest.approx(parts["stigma"][1] + 4.0)


def test_parameters_have_dotted_names():
    assert [*pf.parameters(pf.Stamen)] == [
        "filament.r",
        "filament.h",
        "filament.a_2",
        "filament.taper",
        "anther.r",
        "anther.swell",
        "tilt",
    ]
    assert value_at(STAMEN, "filament.h") == 18.0
    assert pf.parameters(STAMEN.part(0)) == pf.parameters(STAMEN)


def test_samples_and_meshes_are_of_all_parts():
    areas = [float(surface.area()) for _, surface in PISTIL.parts().values()]
    assert float(PISTIL.area()) == pytest.approx(sum(areas))
    cloud = PISTIL.sample(3000, seed=1)
    tip = cloud.points[:, 1] > 15.0
    assert np.mean(tip) == pytest.approx(
        np.mean(PISTIL.mesh((65, 65)).sample(20000)[:, 1] > 15.0), abs=0.03
    )
    assert PISTIL.mesh((17, 17)).area == pytest.approx(sum(areas), rel=0.1)
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0)


def test_masks_of_assemblies_are_refused():
    camera = pf.Camera.look_at((0, 0, 50), (0, 10, 0), (64, 64), pixels_per_unit=2.0)
    mask = pf.Filament(r=2.0).silhouette(camera)
    with pytest.raises(pf.TargetError, match="a Stamen is fitted to one cloud"):
        pf.fit(pf.Stamen, mask)


@pytest.mark.slow
@pytest.mark.parametrize("name", ORGANS)
def test_an_assembly_comes_back_from_its_own_cloud(name, tmp_path):
    """2,000 points with noise of half a percent; without a start."""
    truth = ORGANS[name]
    cloud = truth.sample(2000, seed=1)
    noise = 0.005 * cloud.diagonal
    rng = np.random.default_rng(2)
    model = pf.CompoundPistil(carpels=2) if name == "compound" else type(truth)
    result = pf.fit(model, cloud.points + noise * rng.standard_normal((2000, 3)))
    assert result.noise == pytest.approx(noise, rel=0.1)
    for parameter in result.names:
        assert result.identifiable[parameter]
        error = abs(result.values[parameter] - value_at(truth, parameter))
        assert error < 5 * result.stderr[parameter], parameter
    result.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json")
    assert jax.tree.leaves(again.model) == jax.tree.leaves(result.model)
