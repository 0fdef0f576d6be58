"""Options that a fit does not use are refused, and components of every shape are looked at."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import petalfit as pf
from petalfit.surfaces import angle, length, number


@pytest.mark.parametrize(
    ("model", "pose"),
    [
        (pf.BladePetal, "rigid"),
        (pf.BladePetal, "similarity"),
        (pf.PeonyPetal, "rigid"),
    ],
)
def test_a_fit_starts_where_an_earlier_one_ended(model, pose):
    # One end is clearly the base.
    blade = pf.BladePetal(
        length=12.0, widest=0.7, base_width=0.1, tip_width=0.3, bend=0.6, cup_mid=0.4
    )
    petal = blade if model is pf.BladePetal else pf.PeonyPetal(dy=2.0)
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn = turn * np.sign(np.linalg.det(turn))
    unit = 0.5 if pose == "similarity" else 1.0
    clouds = [petal.sample(600, seed=seed, noise=0.02).points for seed in (1, 2)]
    first, second = (unit * (points @ turn.T + [3.0, -40.0, 7.0]) for points in clouds)
    earlier = pf.fit(model, first, pose=pose)
    anew = pf.fit(model, second, pose=pose)
    again = pf.fit(model, second, pose=pose, init=earlier)
    assert again.converged
    for name in again.names:
        if again.identifiable[name]:
            away = again.values[name] - anew.values[name]
            assert abs(away) < 0.5 * anew.stderr[name], name


@pytest.mark.parametrize("model", [pf.PeonyPetal, pf.BladePetal])
def test_an_earlier_result_of_another_cloud_is_no_traceback(model):
    cloud = model().sample(400, seed=1, noise=0.02).points
    earlier = pf.fit(model, cloud, pose="similarity", loss="robust")
    elsewhere = 30.0 * cloud[:, [1, 2, 0]] + [2e3, -5e3, 1e4]
    found = pf.fit(model, elsewhere, pose="similarity", loss="robust", init=earlier, throw=False)
    assert not found.converged or found.rms < 1.0


def test_an_earlier_result_at_the_end_of_a_range_is_a_start():
    cloud = pf.BladePetal().sample(300, seed=1, noise=0.02).points
    earlier = pf.fit(pf.BladePetal, cloud, pose="rigid")
    ended = dataclasses.replace(earlier.model, widest=0.92, base_width=-1e-17)
    found = pf.fit(
        pf.BladePetal, cloud, pose="rigid", init=dataclasses.replace(earlier, model=ended)
    )
    assert found.rms < 2 * earlier.rms


def test_an_earlier_result_goes_with_one_cloud_and_no_base():
    cloud = pf.BladePetal().sample(300, seed=1, noise=0.02).points
    earlier = pf.fit(pf.BladePetal, cloud, pose="rigid")
    with pytest.raises(pf.TargetError, match="says where the base is; leave base out"):
        pf.fit(pf.BladePetal, cloud, pose="rigid", init=earlier, base="other")
    with pytest.raises(pf.TargetError, match="has no pose to start from; give an earlier result"):
        pf.fit(pf.BladePetal, cloud, pose="rigid", init=pf.BladePetal())
    assert pf.fit(pf.BladePetal, cloud, init=earlier).converged


@pytest.mark.parametrize(
    ("option", "value"),
    [("free", ["a_x"]), ("init", pf.SplinePetal())],
)
def test_a_spline_takes_neither_free_nor_init(option, value):
    cloud = pf.PeonyPetal().sample(300)
    with pytest.raises(pf.TargetError, match=f"SplinePetal does not use {option}"):
        pf.fit(pf.SplinePetal, cloud, **{option: value})


def test_a_spline_uses_the_noise_that_it_is_given():
    cloud = pf.PeonyPetal().sample(400, seed=0, noise=0.05)
    assert pf.fit(pf.SplinePetal, cloud, noise=0.2).noise == 0.2


@pytest.mark.parametrize(
    ("model", "options", "match"),
    [
        (pf.RibPattern, {"pose": "rigid"}, "pattern does not use pose"),
        (pf.RibPattern, {"loss": "robust"}, "pattern does not use loss"),
        (pf.PeonyPetal, {"palette": ("#fff", "#f0f")}, "component does not use palette"),
        (pf.PeonyPetal, {"surface": pf.PeonyPetal}, "component does not use surface"),
        (
            pf.PeonyPetal,
            {"camera": pf.Camera.orthographic(np.eye(3), 1.0, (0.0, 0.0), (8, 8))},
            "camera is for masks",
        ),
    ],
)
def test_what_a_fit_does_not_use_is_refused(model, options, match):
    cloud = pf.PeonyPetal().sample(100, seed=0)
    target = np.random.default_rng(0).random((16, 16)) if model is pf.RibPattern else cloud
    with pytest.raises(pf.TargetError, match=match):
        pf.fit(model, target, **options)


class Ruler(pf.AbstractSurface):
    """A strip whose lengths all begin at 0, and with a parameter that a pose has too."""

    reach: pf.Scalar = length(5.0, "l", (0.0, 50.0), (2.0, 20.0), "along y")
    scale: pf.Scalar = number(0.3, "s", (0.05, 2.0), (0.1, 0.9), "width, in lengths")
    domain: ClassVar[pf.Domain] = pf.Domain((-0.5, 0.5), (0.0, 1.0))
    regular: ClassVar[bool] = True

    def position(self, u, v):
        return jnp.stack([self.scale * self.reach * u, self.reach * v, 0.3 * v**2], axis=-1)


class Angles(pf.AbstractSurface):
    """A square of side 1 without any length, folded along its middle."""

    fold: pf.Scalar = angle(0.3, "φ", (-1.4, 1.4), (0.0, 1.0), "rise of each half")
    domain: ClassVar[pf.Domain] = pf.Domain((-0.5, 0.5), (0.0, 1.0))
    regular: ClassVar[bool] = True

    def position(self, u, v):
        return jnp.stack([u * jnp.cos(self.fold), v, jnp.abs(u) * jnp.sin(self.fold)], axis=-1)


@pytest.mark.parametrize("truth", [Ruler(reach=8.0, scale=0.5), Angles(fold=0.6)], ids=repr)
def test_components_without_lengths_or_with_lengths_from_0(truth, tmp_path):
    """And a parameter called scale is one like others."""
    result = pf.fit(type(truth), truth.sample(600, seed=1, noise=0.005))
    for name in result.names:
        assert result.identifiable[name]
        assert abs(result.values[name] - getattr(truth, name)) < 5 * result.stderr[name]
    assert set(result.declared) == set(result.values)
    assert result.rivals == ()
    result.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json", model=type(truth))
    assert again.declared == result.declared
    result.report(tmp_path / "report.html")


def test_a_pose_of_a_component_with_its_names_is_refused():
    cloud = Ruler().sample(300, seed=1)
    with pytest.raises(pf.TargetError, match="scale of Ruler are names of a pose's own"):
        pf.fit(Ruler, cloud, pose="rigid")


def test_a_profile_keeps_outliers_out():
    """Each point counts in it as much as in the fit."""
    petal = pf.PeonyPetal(a_x=13.0, b_y=24.0)
    points = petal.sample(600, seed=4, noise=0.05).points
    outliers = np.random.default_rng(1).uniform(points.min(axis=0), points.max(axis=0), (60, 3))
    result = pf.fit_petal(np.concatenate([points, outliers]), loss="robust")
    low, high = result.with_profile("dy", points=7).profiles["dy"].interval()
    assert low < result.values["dy"] < high
    assert 3 < (high - low) / result.stderr["dy"] < 5


def test_a_file_of_an_earlier_version_names_the_command_that_makes_it_again(tmp_path):
    path = tmp_path / "fit.json"
    path.write_text(
        '{"format": "petalfit.FitResult", "version": 3, "command": "petalfit fit a.ply --out b"}'
    )
    with pytest.raises(pf.TargetError, match=r"Fit the target again: petalfit fit a\.ply --out b"):
        pf.FitResult.load(path)


def test_weights_are_numbers_of_observations():
    cloud = pf.PeonyPetal().sample(100, seed=1)
    with pytest.raises(pf.TargetError, match="weights reach 1e\\+300"):
        pf.fit_petal(pf.PointCloud(cloud.points, weights=np.full(100, 1e300)))


def test_a_blade_needs_points_in_its_strips():
    points = pf.BladePetal().sample(40, seed=1).points
    with pytest.raises(pf.TargetError, match="40 points are too few for a BladePetal; give 64"):
        pf.fit_petal(points, model=pf.BladePetal, pose="rigid")
