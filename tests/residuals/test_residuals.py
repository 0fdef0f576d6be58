"""Foot points, edges and the curvature bias, against brute force and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import erfcx
from scipy.stats import norm

from petalfit.components import PeonyPetal
from petalfit.residuals import (
    EDGE_NODES,
    edge_nodes,
    edge_pull,
    edge_residual,
    edge_score,
    frame,
    frames,
    nearest_nodes,
    perturbation,
    pull_back,
    refine_foot_points,
)
from petalfit.surfaces import Ellipsoid, Rectangle


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def leaves(tree):
    return np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(tree)])


def test_foot_points_are_as_near_as_the_nearest_of_a_million_samples():
    petal = jax.tree.map(jnp.asarray, PeonyPetal(rib_frequency=13.0))
    points = jnp.asarray(petal.sample(400, seed=5, noise=0.3).points)
    uv = refine_foot_points(petal, points, nearest_nodes(petal, points), 8)
    distance = np.linalg.norm(points - petal(uv[:, 0], uv[:, 1]), axis=-1)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 1601), np.linspace(0, 1, 641))
    sampled, _ = cKDTree(np.asarray(petal(u.ravel(), v.ravel()))).query(points)
    # A coarse start may end on the wrong side of a rib, for a few.
    assert np.mean(distance <= sampled + 1e-9) > 0.97
    # Where they are interior, the offset is along the normal.
    inside = np.all((uv > jnp.array([-0.5, 0.0])) & (uv < jnp.array([0.5, 1.0])), axis=1)
    along = np.abs(frames(petal, uv).distance(points))
    np.testing.assert_allclose(along[inside], distance[inside], atol=1e-6)


def test_foot_points_of_an_ellipsoid_survive_its_poles_and_its_centre():
    surface = jax.tree.map(jnp.asarray, Ellipsoid(1.0, 3.0, 2.0))
    points = jnp.array([[0, 5.0, 0], [0, -5.0, 0], [0, 0, 0], [3.0, 0, 0], [0, 0, 4.0]])
    uv = refine_foot_points(surface, points, nearest_nodes(surface, points), 8)
    distance = np.linalg.norm(points - surface(uv[:, 0], uv[:, 1]), axis=-1)
    np.testing.assert_allclose(distance, [2, 2, 1, 2, 2], atol=1e-6)


def test_distance_beyond_the_edges_of_a_rectangle():
    surface = jax.tree.map(jnp.asarray, Rectangle(4.0, 6.0))
    # The last two: beyond a u edge by 1 and above the plane; inside.
    points = jnp.array([[2.5, 3.0, 0.2], [-1.0, 6.7, 0.0], [3.0, 5.0, -0.3], [1.0, 2.0, 0.1]])
    uv = refine_foot_points(surface, points, nearest_nodes(surface, points), 4)
    beyond = frames(surface, uv).beyond(points)
    np.testing.assert_allclose(beyond, [[0.5, -3], [-1, 0.7], [1, -1], [-1, -2]], atol=1e-9)


def test_edge_residual_and_its_slope():
    e = np.linspace(-5.5, 30.0, 200)
    np.testing.assert_allclose(edge_residual(e) ** 2, -2 * norm.logsf(e), rtol=1e-8)
    h = 1e-6
    slope = -(norm.logsf(e + h) - norm.logsf(e - h)) / (2 * h)
    np.testing.assert_allclose(edge_score(e), slope, rtol=1e-5, atol=1e-9)
    # Far outside, φ/Φ(−e) = √(2/π) / erfcx(e/√2); a wrong start has points 10¹⁰ σ beyond an edge.
    remote = np.geomspace(10.0, 1e12, 100)
    exact = np.sqrt(2 / np.pi) / erfcx(remote / np.sqrt(2))
    np.testing.assert_allclose(edge_score(remote), exact, rtol=1e-9)
    np.testing.assert_allclose(edge_residual(remote), remote, rtol=0.04)
    for function in (edge_residual, edge_score):
        assert np.isfinite(jax.vmap(jax.grad(function))(jnp.linspace(-50.0, 50.0, 1001))).all()


def pull_of_edges(surface, uv, sigma=0.01):
    nodes = jnp.asarray(edge_nodes(surface.domain))
    weights, inside = jnp.ones(len(uv)), jnp.full(len(uv), -jnp.inf)
    pull = edge_pull(surface, frame(surface, nodes), uv, weights, inside, jnp.asarray(sigma))
    return leaves(pull_back(surface, nodes[:EDGE_NODES], pull)).sum(axis=-1)


def test_edge_pull_of_a_uniform_cloud_is_the_derivative_of_n_log_area():
    surface = jax.tree.map(jnp.asarray, Rectangle(4.0, 6.0, 0.5))
    rng = np.random.default_rng(0)
    n = 40_000
    uv = jnp.asarray(rng.uniform([-0.5, 0.0], [0.5, 1.0], (n, 2)))
    # d log(a_x b_y) is n/a_x and n/b_y; the height of the plane changes no area.
    np.testing.assert_allclose(pull_of_edges(surface, uv), [n / 4, n / 6, 0], rtol=0.03, atol=1e-9)


def test_edges_of_a_narrow_surface_are_pulled_no_more_than_noise_allows():
    """The derivative of log ∫Φ(x/σ) Φ((w − x)/σ) dx by the width, by quadrature."""
    sigma, h = 0.3, 1e-4
    x = np.linspace(-10.0, 15.0, 200_001)
    uv = jnp.asarray(np.random.default_rng(0).uniform([-0.5, 0], [0.5, 1], (40_000, 2)))

    def logarithm(width):
        return np.log(np.trapezoid(norm.cdf(x / sigma) * norm.cdf((width - x) / sigma), x))

    for width in (0.02, 0.3, 1.0, 4.0):
        surface = jax.tree.map(jnp.asarray, Rectangle(width, 60.0))
        by_width = (logarithm(width + h) - logarithm(width - h)) / (2 * h)
        pull = pull_of_edges(surface, uv, sigma)[0]
        assert pull == pytest.approx(len(uv) * by_width, rel=0.03)


def test_the_edge_is_not_pulled_where_there_are_no_points():
    surface = jax.tree.map(jnp.asarray, Rectangle(4.0, 6.0))
    uv = jnp.asarray(np.random.default_rng(0).uniform([-0.5, 0.0], [0.5, 0.5], (1000, 2)))
    half, full = (pull_of_edges(surface, x) for x in (uv, uv * 2 ** np.array([0, 1])))
    assert half[1] < 0.05 * full[1]


def test_pull_back_equals_forward_derivatives():
    petal = jax.tree.map(jnp.asarray, PeonyPetal())
    rng = np.random.default_rng(0)
    uv = jnp.asarray(rng.uniform([-0.5, 0.0], [0.5, 1.0], (7, 2)))
    w = jnp.asarray(rng.standard_normal((7, 3)))
    jacobian = jax.jacfwd(lambda p: p(uv[:, 0], uv[:, 1]))(petal)
    np.testing.assert_allclose(
        leaves(pull_back(petal, uv, w)),
        np.stack([np.sum(np.asarray(leaf) * w, axis=-1) for leaf in jax.tree.leaves(jacobian)]),
        rtol=1e-10,
        atol=1e-10,
    )


def test_perturbed_points_of_a_sphere_show_its_curvature_bias():
    # E d = σ²/r for a sphere: noise across the line of sight lengthens the distance to the centre.
    r, sigma = 2.0, 0.02
    surface = jax.tree.map(jnp.asarray, Ellipsoid(r, r, r))
    n = 20_000
    rng = np.random.default_rng(0)
    direction = rng.standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    uv = jnp.asarray(
        np.stack(
            [
                np.arcsin(direction[:, 1]),
                np.arctan2(direction[:, 2], direction[:, 0]) % (2 * np.pi),
            ],
            -1,
        )
    )
    noise = sigma * jnp.asarray(perturbation(np.asarray(uv)))
    np.testing.assert_allclose(np.cov(noise.T), sigma**2 * np.eye(3), atol=0.03 * sigma**2)
    distances = []
    for moved in (surface(*uv.T) + noise, surface(*uv.T) - noise):
        distances.append(frames(surface, refine_foot_points(surface, moved, uv, 4)).distance(moved))
    # The mean of both signs has lost the part that is linear in the noise, and with it the scatter.
    assert np.mean(distances) == pytest.approx(sigma**2 / r, rel=0.05)
