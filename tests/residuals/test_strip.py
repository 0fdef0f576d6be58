"""The potential of a strip, compared with SciPy's minimiser and normal distribution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from petalfit.residuals import potential

compiled = jax.jit(potential)


def of(x, half, rho):
    with jax.enable_x64(True):
        x, half = map(jnp.asarray, np.broadcast_arrays(x, half))
        return [np.asarray(part) for part in compiled(x, half, jnp.asarray(rho))]


@pytest.mark.parametrize("rho", [0.1, 0.6, 0.95])
@pytest.mark.parametrize("half", [0.4, 2.0, 15.0])
@pytest.mark.parametrize("beyond", [-3.0, -0.5, 0.0, 0.8, 3.0])
def test_the_least_value_over_places_is_the_likelihood_of_a_blurred_strip(half, rho, beyond):
    e = half + beyond

    def cost(x):
        return (e - x) ** 2 / (2 * rho) + float(of(x, half, rho)[0])

    least = minimize_scalar(cost, bounds=(-half - 6, half + 6), method="bounded").fun
    expected = -np.log(norm.cdf(half - e) - norm.cdf(-half - e))
    assert least == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize("rho", [0.1, 0.9])
@pytest.mark.parametrize("half", [0.4, 2.0, 15.0])
def test_derivatives_are_those_of_differences(half, rho):
    x, h = half + np.array([-2.1, -0.7, 0.3, 2.4]), 1e-4
    _, slope, curvature, by_width = of(x, half, rho)
    up, down = of(x + h, half, rho), of(x - h, half, rho)
    wide, narrow = of(x, half + h, rho), of(x, half - h, rho)
    assert slope == pytest.approx((up[0] - down[0]) / (2 * h), abs=2e-3)
    assert curvature == pytest.approx((up[1] - down[1]) / (2 * h), abs=2e-3)
    assert by_width == pytest.approx((wide[0] - narrow[0]) / (2 * h), abs=2e-3)
    by_rho = of(x, half, rho + h)[0] - of(x, half, rho - h)[0]
    # ∂F/∂ρ is half the square of the slope.
    assert by_rho / (2 * h) == pytest.approx(0.5 * slope**2, abs=5e-3)


def test_far_inside_nothing_is_lost_and_far_outside_it_is_a_spring():
    value, slope, curvature, _ = of(np.array([0.0, 36.0]), 30.0, 0.5)
    assert [value[0], slope[0], curvature[0]] == pytest.approx([0, 0, 0], abs=1e-12)
    # Beyond the edge −log Φ(−e) is about e²/2, and F is about x²/2(1 − ρ).
    assert curvature[1] == pytest.approx(1 / (1 - 0.5), rel=0.05)
