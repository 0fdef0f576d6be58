"""Derivatives through a fit equal finite differences of refits."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.solver.implicit import solve_differentiably
from petalfit.residuals import Data, nearest_nodes, refine_foot_points


def declared_length(default, meaning):
    return pf.parameter(
        default,
        symbol="",
        unit="length",
        bounds=(-50.0, 50.0),
        typical=(-5.0, 5.0),
        meaning=meaning,
    )


class Dome(pf.AbstractDeformedSurface):
    """A rectangle with a hump: the smallest component that has edges and curvature."""

    width: pf.Scalar = declared_length(4.0, "along x")
    length: pf.Scalar = declared_length(6.0, "along y")
    rise: pf.Scalar = declared_length(1.0, "of the hump")
    domain: ClassVar[pf.Domain] = pf.Rectangle.domain
    regular: ClassVar[bool] = True

    @property
    def base(self):
        return pf.Rectangle(self.width, self.length)

    def height(self, u, v, point):
        return self.rise * jnp.cos(jnp.pi * u) * jnp.sin(jnp.pi * v)


def check_gradient(model, free, n, seed):
    """A random combination of the fitted coordinates, by every coordinate of every point."""
    points = model.sample(n, seed=seed, noise=0.03).points
    with jax.enable_x64(True):
        coordinates = Coordinates.of(model, free)
        t = jnp.asarray(coordinates.inverse(coordinates.template))
        x = jnp.asarray(points)
        nodes = nearest_nodes(coordinates.template, points)
        uv = jnp.asarray(refine_foot_points(coordinates.template, points, nodes, 6))
        combination = jnp.linspace(1.0, 2.0, len(free))

        @jax.jit
        @jax.value_and_grad
        def scalar(points):
            data = Data(points, jnp.ones(n), jnp.asarray(0.03))
            return combination @ solve_differentiably(coordinates, data, t, uv)

        _, gradient = scalar(x)
        size = np.max(np.abs(gradient))
        assert size > 1e-5
        rng = np.random.default_rng(1)
        h = 1e-4
        for _ in range(4):
            direction = np.zeros_like(points)
            direction[rng.integers(n, size=8)] = rng.standard_normal((8, 3))
            high, low = (scalar(jnp.asarray(points + s * h * direction))[0] for s in (1, -1))
            np.testing.assert_allclose(
                np.sum(gradient * direction), (high - low) / (2 * h), atol=2e-4 * size
            )


def test_gradient_of_a_small_component_with_respect_to_the_points():
    check_gradient(Dome(), ("width", "length", "rise"), 100, 2)


@pytest.mark.slow
def test_gradient_of_a_petal_with_respect_to_the_points():
    petal = pf.PeonyPetal(a_x=16.0, rib_frequency=8.0, rib_amplitude=0.2, midrib_height=1.0)
    free = ("a_x", "b_y", "c", "dx", "dy", "rib_frequency", "rib_amplitude")
    check_gradient(petal, free, 200, 3)
