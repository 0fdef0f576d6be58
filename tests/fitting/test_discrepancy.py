"""Errors under misfit: smooth fields that are planted on surfaces, and what the errors make of them."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import petalfit as pf
from petalfit.fitting.inference.discrepancy import (
    Rows,
    discrepancy_of,
    is_suspect,
    temperature,
)

from .conftest import NAMES

PETAL = pf.PeonyPetal(c_z=0.3)


def field(places, length, smooth, rng):
    """A Gaussian random field of unit variance: RBF, or Matérn with ν = 3/2."""
    apart = cdist(places, places) / length
    kernel = np.exp(-0.5 * apart**2)
    if not smooth:
        kernel = (1 + np.sqrt(3) * apart) * np.exp(-np.sqrt(3) * apart)
    return np.linalg.cholesky(kernel + 1e-8 * np.eye(len(places))) @ rng.normal(size=len(places))


def linear_rows(length, smooth, seed, n=900):
    """Least squares with 15 smooth parameters, all of them 0; returns the estimates and the rows."""
    rng = np.random.default_rng(seed)
    uv = rng.random((n, 2))
    places = np.column_stack([0.5 * uv[:, 0], uv[:, 1], np.zeros(n)])
    u, v = 2 * uv.T - 1
    slopes = np.stack([u**i * v**j for i in range(5) for j in range(5) if i + j <= 4], axis=1)
    distances = rng.normal(size=n)
    if length is not None:
        distances += 2 * field(places, length, smooth, rng)
    estimate = np.linalg.lstsq(slopes, distances)[0]
    rest = distances - slopes @ estimate
    sigma = float(np.sqrt(rest @ rest / (n - len(estimate))))
    cell = np.minimum((uv * 14).astype(int), 13) @ [14, 1]
    nothing = np.zeros_like(slopes)
    information = slopes.T @ slopes / sigma**2
    rows = Rows(places, cell, rest, np.ones(n), slopes, nothing, sigma, information)
    return estimate, rows


def covered(estimate, rows):
    """Shares of 95 % intervals that hold the truth: with the discrepancy, and for independent noise."""
    inverse = np.linalg.inv(rows.information)
    found = discrepancy_of(rows)
    scatter = rows.information + (0 if found is None else found[1])
    errors = [np.sqrt(np.diag(inverse @ x @ inverse)) for x in (scatter, rows.information)]
    return [np.mean(np.abs(estimate) < 1.96 * e) for e in errors]


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("length", [0.05, 0.1, 0.2])
def test_intervals_hold_under_a_linear_misfit(length, smooth):
    shares = np.mean([covered(*linear_rows(length, smooth, seed)) for seed in range(12)], axis=0)
    assert shares[0] > 0.86
    assert shares[1] < 0.65


def test_noise_alone_has_no_discrepancy():
    every = [linear_rows(None, True, seed)[1] for seed in range(30)]
    assert sum(discrepancy_of(rows) is not None for rows in every) <= 2


def test_rounding_chooses_no_directions():
    _, rows = linear_rows(0.1, True, 0)
    # The effect of a length that is also a scale's, and that of an edge, which distances do not know.
    twice, nothing = rows.slopes.sum(axis=1, keepdims=True), np.zeros((len(rows.slopes), 3))
    slopes = np.hstack([rows.slopes, twice, nothing])
    edge = np.hstack([0 * rows.slopes, 0 * twice, nothing + 1 + rows.place])
    information = (slopes.T @ slopes + edge.T @ edge) / rows.sigma**2
    every = []
    for seed in range(3):
        rounding = 1 + 1e-13 * np.random.default_rng(seed).normal(size=slopes.shape)
        tiny = 1e-13 * np.random.default_rng(seed).normal(size=slopes.shape)
        found = discrepancy_of(
            rows._replace(slopes=slopes * rounding + tiny, edge=edge, information=information)
        )
        assert found is not None
        every.append(found[1])
    first, *others = every
    scale = np.sqrt(np.outer(np.diag(first), np.diag(first)))
    assert all(np.abs((other - first) / scale).max() < 1e-8 for other in others)


def test_the_temperature_is_bounded_and_one_without_misfit():
    _, rows = linear_rows(0.1, True, 0)
    found = discrepancy_of(rows)
    assert found is not None
    total = float(np.sum(rows.weights))
    assert 1 < temperature(rows, found[1], total) <= total / 100
    assert temperature(rows, found[1], 50.0) == 1
    assert temperature(rows, 0 * found[1], total) == 1


@pytest.mark.parametrize(("length", "share"), [(None, (0.0, 0.4)), (0.1, (1.0, 1.0))])
def test_the_first_look_passes_misfits(length, share):
    every = [linear_rows(length, True, seed)[1] for seed in range(20)]
    seen = [is_suspect(x.cell, x.distance, x.weights, x.slopes.shape[1]) for x in every]
    assert share[0] <= np.mean(seen) <= share[1]


def test_its_size_and_length_are_those_of_the_field():
    found = [discrepancy_of(linear_rows(0.1, True, seed)[1]) for seed in range(8)]
    sizes, lengths = zip(*((x.deviation, x.length) for x, _ in found), strict=True)
    assert 1.4 < np.median(sizes) < 2.8
    assert 0.06 < np.median(lengths) < 0.17
    assert all(
        x.share == pytest.approx(x.deviation**2 / (x.deviation**2 + x.noise**2)) for x, _ in found
    )


def bumpy(seed, deviation=0.1, noise=0.03):
    """Points of a petal that a smooth field has moved along z, about the normal."""
    rng = np.random.default_rng(seed)
    points = np.asarray(PETAL.sample(1200, seed=seed).points, float)
    moved = deviation * field(points, 1.5, True, rng)
    return points + moved[:, None] * [0, 0, 1] + noise * rng.normal(size=points.shape)


@pytest.fixture(scope="module")
def misfits():
    return [pf.fit_petal(bumpy(seed), throw=False) for seed in range(12)]


def test_intervals_of_petals_hold_under_misfit(misfits):
    by_kind = {"stderr": [], "stderr_noise": []}
    for result in misfits:
        for kind, z in by_kind.items():
            errors = getattr(result, kind)
            z += [
                abs(result.values[n] - getattr(PETAL, n)) / errors[n]
                for n in NAMES
                if np.isfinite(errors[n])
            ]
    shares = {kind: np.mean(np.array(z) < 1.96) for kind, z in by_kind.items()}
    assert shares["stderr"] > 0.85
    assert shares["stderr_noise"] < 0.7


def test_both_errors_are_there_and_in_the_file(misfits, tmp_path):
    result = misfits[0]
    assert result.discrepancy is not None
    assert all(result.stderr_noise[n] <= e * (1 + 1e-9) for n, e in result.stderr.items())
    assert any("misfit" in note for note in result.notes)
    result.save(tmp_path / "fit.json")
    again = pf.FitResult.load(tmp_path / "fit.json")
    assert again.discrepancy == result.discrepancy
    assert again.stderr_noise == result.stderr_noise


def test_both_errors_are_shown(misfits, tmp_path):
    misfits[0].report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "by noise alone" in page
    assert "allow for a misfit" in page


def test_without_misfit_both_errors_are_the_same(result):
    assert result.discrepancy is None
    assert result.stderr_noise == result.stderr
