"""Options, results and refusals of the public entry."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import petalfit as pf
from petalfit.compilation import bucket
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.families import polish
from petalfit.fitting.families.peony.ribs import rib_periodogram

from .conftest import NAMES, SIGMA, noisy_cloud


def test_result_is_complete(cloud, result):
    petal, points = cloud
    assert isinstance(result.model, pf.PeonyPetal)
    assert result.converged
    assert result.status == "converged"
    assert result.names == tuple(NAMES)
    assert set(result.values) == set(pf.parameters(pf.PeonyPetal))
    assert result.values["midrib_sharpness"] == 800
    assert "midrib_sharpness" not in result.stderr
    assert result.noise == pytest.approx(SIGMA, rel=0.08)
    assert result.rms == pytest.approx(SIGMA, rel=0.1)
    assert result.distances.shape == result.weights.shape == (len(points),)
    errors = np.sqrt(np.diag(result.covariance))
    np.testing.assert_allclose(errors, [result.stderr[name] for name in NAMES])
    assert all(result.identifiable.values())
    assert result.starts[0].delta_chi2 == 0
    for name, (low, high) in result.interval(0.9999).items():
        assert low < getattr(petal, name) < high
    assert result.mesh((9, 7)).vertices.shape == (63, 3)
    np.testing.assert_array_equal(result.pose.rotation, np.eye(3))


def test_interval_refuses_an_impossible_level(result):
    with pytest.raises(ValueError, match="between 0 and 1"):
        result.interval(95.0)


def test_saving_is_lossless(result, tmp_path):
    path = tmp_path / "fit.json"
    result.save(path)
    loaded = pf.FitResult.load(path)
    loaded.save(tmp_path / "again.json")
    assert path.read_bytes() == (tmp_path / "again.json").read_bytes()
    assert loaded.values == result.values
    assert loaded.stderr == result.stderr
    np.testing.assert_array_equal(loaded.covariance, result.covariance)
    np.testing.assert_array_equal(
        loaded.agreements[0].target.points, result.agreements[0].target.points
    )
    assert loaded.starts == result.starts
    assert loaded.model == result.model


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"\x00\xff", "cannot be read"),
        (b"{}", "is not a fit result"),
        (b'{"format": "petalfit.FitResult", "version": 99}', "version 99"),
        (b'{"format": "petalfit.FitResult", "version": 5, "model": "PeonyPetal"}', "damaged"),
    ],
)
def test_a_file_that_is_no_result_is_refused(content, match, tmp_path):
    path = tmp_path / "fit.json"
    path.write_bytes(content)
    with pytest.raises(pf.TargetError, match=match):
        pf.FitResult.load(path)


def test_free_parameters_and_a_start(cloud, result):
    petal, points = cloud
    some = pf.fit(petal, points, free=["dy", "a_x", "dx"])
    assert some.names == ("a_x", "dx", "dy")
    assert some.values["tip_curl"] == petal.tip_curl
    assert some.stderr["a_x"] < result.stderr["a_x"]
    near = pf.PeonyPetal(a_x=14.4, b_y=21.5, c=0.65, rib_frequency=20.3, c_z=0.2)
    started = pf.fit_petal(points, init=near)
    assert started.starts[0].label == "given"
    for name in NAMES:
        assert abs(started.values[name] - result.values[name]) < 0.25 * result.stderr[name]


def test_free_heights_of_a_start_that_is_right_otherwise(cloud):
    petal, points = cloud
    some = pf.fit(petal, points, free=["a_x", "b_y", "c"])
    for name in some.names:
        assert abs(some.values[name] - getattr(petal, name)) < 4 * some.stderr[name]


def test_a_given_noise_is_used(cloud):
    assert pf.fit_petal(cloud[1], noise=0.05).noise == 0.05
    strict = pf.fit_petal(cloud[1], noise=0.01)
    assert any("times the given noise" in warning for warning in strict.warnings)


def test_without_ribs_their_frequency_is_not_determined():
    petal = pf.PeonyPetal(rib_amplitude=0.0)
    points, _ = noisy_cloud(petal, 1500, SIGMA, np.random.default_rng(2))
    result = pf.fit_petal(points, throw=False)
    assert not result.identifiable["rib_frequency"]
    assert result.stderr["rib_frequency"] == math.inf
    assert result.interval()["rib_frequency"] == (-math.inf, math.inf)
    assert "rib_frequency is not determined by this target" in result.warnings
    assert abs(result.values["a_x"] - petal.a_x) < 6 * result.stderr["a_x"]


def test_a_periodogram_of_nothing_has_a_peak_all_the_same():
    zero = np.zeros(9)
    nothing = (np.zeros((9, 2)), np.zeros((9, 1)))
    (basin,) = rib_periodogram(None, zero, np.ones(9), np.ones(9), *nothing)
    assert basin.amplitude == basin.gain == 0
    assert math.isfinite(basin.frequency)


def test_a_cloud_in_another_frame_is_not_accepted_in_silence(cloud):
    points = cloud[1]
    turned = points[:, [2, 0, 1]] + 7.0
    result = pf.fit_petal(turned, throw=False)
    assert not result.converged
    assert result.status == "misfit"
    assert "not in the model's frame" in result.message
    with pytest.raises(pf.FitError, match="no petal of this model fits"):
        pf.fit_petal(turned)


def test_no_other_number_of_points_compiles_anything(cloud):
    points = cloud[1]
    assert pf.fit_petal(points[:900]).timings["polishing"] > 0
    for number in (300, 1480):
        assert "compiling" not in pf.fit_petal(points[:number]).timings


def test_buckets_waste_at_most_a_third():
    sizes = {n: bucket(n) for n in range(1, 70_000, 7)}
    assert list(sizes.values()) == sorted(sizes.values())
    assert len(set(sizes.values())) < 25
    assert all(n <= size <= max(64, 1.5 * n) for n, size in sizes.items())


def test_coordinates_are_a_bijection_inside_the_bounds():
    with jax.enable_x64(True):
        coordinates = Coordinates.of(pf.PeonyPetal(), tuple(NAMES))
        t = jnp.asarray(np.random.default_rng(0).standard_normal(len(NAMES)) * 5)
        np.testing.assert_allclose(coordinates.inverse(coordinates.model(t)), t, rtol=1e-9)
        slopes = np.diag(jax.jacfwd(coordinates.values)(t))
        np.testing.assert_allclose(coordinates.slopes(t), slopes, rtol=1e-12)
        far = coordinates.values(1e6 * t)
        for name, value in zip(NAMES, far, strict=True):
            low, high = pf.parameters(pf.PeonyPetal)[name].bounds
            assert low <= value <= high


def test_precision_of_jax_is_left_as_it_was(result):
    assert jnp.zeros(1).dtype == jnp.float32


SPHERE = np.random.default_rng(0).standard_normal((50, 3)) * 5


@pytest.mark.parametrize(
    ("target", "options", "match"),
    [
        (np.zeros((0, 3)), {}, "empty|no points|at least"),
        (SPHERE[:8], {}, "8 points cannot determine 10 free parameters"),
        (np.full((50, 3), 2.0), {}, "coincide"),
        (np.outer(np.arange(50.0), [1, 2, 3]), {}, "line"),
        (np.where(np.arange(150).reshape(50, 3) == 7, np.nan, SPHERE), {}, "NaN|finite"),
        (SPHERE[:, :2], {}, "three|3"),
        (1e6 * SPHERE, {}, "unit"),
        (1e-6 * SPHERE, {}, "unit"),
        (SPHERE, {"free": ["a_x", "a_y"]}, "'a_y'.*a_x, b_y"),
        (SPHERE, {"free": []}, "no parameter"),
        (SPHERE, {"init": pf.PeonyPetal(c=2.0)}, "c = 2 .* outside its range"),
        ("no/such/file.ply", {}, "no/such/file.ply"),
        (object(), {}, "object"),
    ],
)
def test_unusable_targets_are_refused_in_one_sentence(target, options, match):
    with pytest.raises(pf.TargetError, match=match) as error:
        pf.fit_petal(target, **options)
    assert len(str(error.value)) < 400


@pytest.mark.parametrize("options", [{"pose": "free"}, {"loss": "l1"}, {"noise": -1.0}])
def test_impossible_options_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        pf.fit_petal(SPHERE, **options)


def test_a_failed_fit_raises_or_says_so(monkeypatch, cloud):
    monkeypatch.setattr(polish, "_ROUNDS", 1)
    far = pf.PeonyPetal(a_x=16.0, b_y=20.0, dy=1.0)
    with pytest.raises(pf.FitError, match="not converged") as error:
        pf.fit_petal(cloud[1], init=far)
    assert error.value.result.status == "round_limit"
    assert not pf.fit_petal(cloud[1], init=far, throw=False).converged
