"""The spread between petals: planted means and deviations come back, with honest errors."""

import numpy as np
import pytest

from petalfit.results import spread_of


def test_planted_spreads_are_recovered():
    rng = np.random.default_rng(0)
    means, deviations, hits = [], [], []
    for _ in range(400):
        errors = rng.uniform(0.05, 0.3, 12)
        values = 2.0 + 0.4 * rng.normal(size=12) + errors * rng.normal(size=12)
        found = spread_of(values, errors)
        assert found is not None
        assert found.count == 12
        means.append(found.mean.value)
        deviations.append(found.deviation.value)
        hits.append(abs(found.mean.value - 2.0) < 1.96 * found.mean.stderr)
    assert np.mean(means) == pytest.approx(2.0, abs=0.03)
    assert np.mean(np.square(deviations)) == pytest.approx(0.16, rel=0.1)
    # The spread is estimated too, so that Gaussian intervals hold a little less than 95 %.
    assert 0.88 < np.mean(hits) < 0.97


def test_petals_that_are_equal_have_no_spread():
    rng = np.random.default_rng(1)
    found = [spread_of(1 + 0.1 * rng.normal(size=8), np.full(8, 0.1)) for _ in range(200)]
    values = np.array([one.deviation.value for one in found if one is not None])
    errors = np.array([one.deviation.stderr for one in found if one is not None])
    assert np.mean(values == 0) > 0.4
    assert np.mean(values < 2 * errors) > 0.9


def test_equal_errors_give_the_usual_estimates():
    values = np.array([1.0, 2.0, 4.0, 7.0])
    found = spread_of(values, np.full(4, 0.5))
    assert found is not None
    assert found.mean.value == pytest.approx(values.mean())
    assert found.deviation.value**2 == pytest.approx(values.var(ddof=1) - 0.25)


def test_what_petals_do_not_determine_does_not_count():
    values, errors = [1.0, 2.0, 3.0, 99.0], [0.1, 0.1, 0.1, np.inf]
    found = spread_of(values, errors)
    assert found is not None
    assert found.count == 3
    assert found.mean.value == pytest.approx(2.0)
    assert spread_of(values[:2], errors[:2]) is None
