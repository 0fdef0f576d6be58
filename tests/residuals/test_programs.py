"""Posed components are computed in their own frames: with the results of the whole, by plain autodiff."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from petalfit.components import PeonyPetal, Pistil, Posed
from petalfit.residuals import frame, frames, newton, places, pull_back, pulled, slide_foot_points
from petalfit.surfaces import value_at

TURNS = {"turned": (0.3, -0.7, 1.1), "hardly": (1e-9, 0.0, -2e-9), "not": (0.0, 0.0, 0.0)}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def posed(turn):
    rotation = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    shift, origin = (1.0, -2.0, 0.5), np.array([3.0, 1.0, -4.0])
    return Posed(PeonyPetal(), rotation, origin, 2.5, 0.8, *shift, *turn)


@pytest.mark.parametrize("turn", TURNS)
def test_frames_and_foot_points_are_those_of_the_posed_surface(turn):
    surface, rng = posed(TURNS[turn]), np.random.default_rng(0)
    uv = rng.uniform([-0.5, 0.0], [0.5, 1.0], (1000, 2))
    here, there = frames(surface, uv), frame(surface, jnp.asarray(uv))
    for ours, theirs in zip(here, there, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    points = here.position + 0.01 * rng.standard_normal((1000, 3))
    found, _, _ = slide_foot_points(surface, points, uv, 2)
    np.testing.assert_allclose(
        found, newton(surface, jnp.asarray(points), jnp.asarray(uv), 2)[0], atol=1e-9
    )


@pytest.mark.parametrize("turn", TURNS)
def test_derivatives_by_the_pose_are_those_of_the_posed_surface(turn):
    surface, rng = posed(TURNS[turn]), np.random.default_rng(1)
    uv, w = rng.uniform([-0.5, 0.0], [0.5, 1.0], (50, 2)), rng.standard_normal((50, 3))
    w[::7] = 0.0
    names = ("a_x", "turn_z", "scale", "rib_frequency", "shift_y", "turn_x", "shift_x", "turn_y")
    found = pulled(surface, uv, w, names, places(surface, uv))
    tree = pull_back(surface, jnp.asarray(uv), jnp.asarray(w))
    expected = np.stack([np.asarray(value_at(tree, name)) for name in names], axis=-1)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)


def test_derivatives_by_parameters_of_a_part_of_an_assembly():
    part, rng = Pistil().part(1), np.random.default_rng(1)
    low, high = np.array(part.domain).T
    uv, w = rng.uniform(low, high, (20, 2)), rng.standard_normal((20, 3))
    names = ("style.r", "style.bend")
    tree = pull_back(part, jnp.asarray(uv), jnp.asarray(w))
    expected = np.stack([np.asarray(value_at(tree.assembly, name)) for name in names], axis=-1)
    np.testing.assert_allclose(pulled(part, uv, w, names, places(part, uv)), expected, rtol=1e-9)


def test_no_points_have_no_foot_points():
    uv, doubt, squared = slide_foot_points(PeonyPetal(), np.zeros((0, 3)), np.zeros((0, 2)), 2)
    assert uv.shape == (0, 2)
    assert doubt.shape == squared.shape == (0,)
