"""Derivatives through a fit equal finite differences of refits."""

import jax
import jax.numpy as jnp
import numpy as np

import petalfit as pf
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.implicit import solve_differentiably
from petalfit.fitting.programs import plane_feet
from petalfit.fitting.solve import Data

from .conftest import noisy_cloud

FREE = ("a_x", "b_y", "c", "dx", "dy", "rib_frequency", "rib_amplitude")


def test_gradient_with_respect_to_the_points():
    petal = pf.PeonyPetal(a_x=16.0, rib_frequency=8.0, rib_amplitude=0.2, midrib_height=1.0)
    points, _ = noisy_cloud(petal, 200, 0.03, np.random.default_rng(3))
    with jax.enable_x64(True):
        coordinates = Coordinates.of(petal, FREE)
        t = coordinates.inverse(coordinates.gather(coordinates.template))
        uv = plane_feet(coordinates.template, jnp.asarray(points))
        combination = jnp.linspace(1.0, 2.0, len(FREE))

        @jax.jit
        @jax.value_and_grad
        def scalar(points):
            data = Data(points, jnp.ones(200), jnp.asarray(0.03))
            return combination @ solve_differentiably(coordinates, data, t, uv)

        _, gradient = scalar(jnp.asarray(points))
        size = np.max(np.abs(gradient))
        assert size > 1e-4
        rng = np.random.default_rng(1)
        h = 1e-4
        for _ in range(4):
            direction = np.zeros_like(points)
            direction[rng.integers(200, size=8)] = rng.standard_normal((8, 3))
            high, low = (scalar(jnp.asarray(points + s * h * direction))[0] for s in (1, -1))
            np.testing.assert_allclose(
                np.sum(gradient * direction), (high - low) / (2 * h), atol=2e-4 * size
            )
