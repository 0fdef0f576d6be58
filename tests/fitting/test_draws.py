"""Draws of parameters from the posterior of a fit."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import genpareto, kstest

import petalfit as pf
from petalfit.fitting.inference.importance import smoothed

PETAL = pf.PeonyPetal(c_z=0.3)


@pytest.fixture(scope="module")
def found():
    return pf.fit_petal(PETAL.sample(1500, seed=1, noise=0.03))


@pytest.fixture(scope="module")
def draws(found):
    return found.draws(2000, seed=3)


def test_they_scatter_as_the_errors_say(found, draws):
    assert draws.believable
    for name, error in found.stderr.items():
        assert np.std(draws[name]) == pytest.approx(error, rel=0.12)
        assert abs(np.mean(draws[name]) - found.values[name]) < 0.25 * error


def test_they_are_a_dictionary_of_arrays(found, draws):
    values = draws.as_dict()
    assert set(values) == set(found.names)
    assert all(x.shape == (2000,) for x in values.values())
    assert len(draws) == 2000


def test_the_seed_says_which(found, draws):
    assert np.array_equal(found.draws(2000, seed=3).values, draws.values)
    assert not np.array_equal(found.draws(2000, seed=4).values, draws.values)


def test_traits_of_draws(found):
    few = found.draws(150, seed=1)
    traits = few.traits()
    assert set(traits) == set(found.traits)
    one = dataclasses.replace(found.model, **{n: x[7] for n, x in few.as_dict().items()})
    assert traits["area"][7] == pytest.approx(one.mesh((257, 257)).area, rel=2e-3)
    assert np.std(traits["length"]) == pytest.approx(found.traits["length"].stderr, rel=0.25)


def test_bounds_hold():
    flat = pf.fit_petal(
        pf.PeonyPetal(rib_amplitude=0.0).sample(300, seed=2, noise=0.3), throw=False
    )
    draws = flat.draws(500)
    for name in draws.names:
        low, high = flat.declared[name].bounds
        assert low <= draws[name].min()
        assert draws[name].max() <= high


def test_a_scale_is_in_the_targets_unit():
    leaf = pf.BladePetal(length=6.0, width=0.4, bend=0.4, cup_mid=0.5)
    result = pf.fit(
        pf.BladePetal, leaf.sample(800, seed=2, noise=0.02), pose="similarity", throw=False
    )
    draws = result.draws(400)
    assert draws.names[-1] == "scale"
    assert np.median(draws["scale"]) == pytest.approx(float(result.pose.scale), rel=0.02)
    assert np.median(draws.traits()["length"]) == pytest.approx(
        result.traits["length"].value, rel=0.02
    )


def test_without_a_likelihood_of_one_cloud_they_stay_gaussian(found):
    misfit = pf.Discrepancy(deviation=0.1, length=2.0, noise=0.03, smooth=True, inflation=9.0)
    for result in (
        dataclasses.replace(found, discrepancy=misfit),
        dataclasses.replace(found, agreements=found.agreements * 2),
    ):
        draws = result.draws(50)
        assert np.isnan(draws.k_hat)
        assert draws.believable


def test_what_has_no_errors_has_no_draws(found):
    nothing = dataclasses.replace(found, posterior=None)
    with pytest.raises(pf.TargetError, match="no errors"):
        nothing.draws(10)
    with pytest.raises(ValueError, match="positive"):
        found.draws(0)


def test_arviz_is_asked_for_in_words(draws, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "arviz", None)
    with pytest.raises(pf.TargetError, match="pip install arviz"):
        draws.to_arviz()


@pytest.mark.parametrize("shape", [0.1, 0.5, 0.9])
def test_the_shape_of_a_tail_is_found(shape):
    found = [
        smoothed(np.log(genpareto.rvs(shape, size=4000, random_state=seed) + 1e-9))[1]
        for seed in range(10)
    ]
    assert np.median(found) == pytest.approx(shape, abs=0.15)


def test_weights_make_another_distribution():
    # Draws of N(0, 1.5²), weighted to be those of N(0, 1).
    x = 1.5 * np.random.default_rng(0).normal(size=4000)
    weights, k_hat = smoothed(-0.5 * x**2 + 0.5 * (x / 1.5) ** 2)
    assert k_hat < 0.5
    assert weights.sum() == pytest.approx(1)
    drawn = np.random.default_rng(1).choice(x, 1000, p=weights)
    assert kstest(drawn, "norm").pvalue > 1e-3
