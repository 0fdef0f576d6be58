"""Contour distances against projections, and their derivatives against finite differences of outlines."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from petalfit.components import PeonyPetal
from petalfit.fitting.likelihood.matching import Match, rows, term_of_rows
from petalfit.observations import Camera, Contour, Silhouette
from petalfit.residuals import places
from petalfit.surfaces import outline

CAMERAS = {
    "orthographic": Camera.look_at((30, -10, 60), (0, 15, 0), (192, 192), pixels_per_unit=4.0),
    "perspective": Camera.look_at((30, -10, 60), (0, 15, 0), (192, 192)),
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def term_at(petal, camera, rng):
    """The term of random places of a contour one pixel or so from the outline."""
    seen = outline(petal, camera)
    some = rng.choice(len(seen.uv), 100, replace=False)
    place = seen.place[some] + rng.normal(size=(100, 2))
    match = Match(
        seen.uv[some], seen.place[some], seen.normal[some], place, np.ones(100),
        np.ones(100, bool), some,
    )  # fmt: skip
    contour = Contour.of(Silhouette(petal.silhouette(camera).mask, camera))
    return match, term_of_rows([rows(contour, match, np.full(100, 2.0))])


@pytest.mark.parametrize("kind", CAMERAS)
def test_pixels_are_distances_along_the_normal(kind):
    match, term = term_at(PeonyPetal(), CAMERAS[kind], np.random.default_rng(0))
    residual = term.residual(places(PeonyPetal(), term.uv))
    np.testing.assert_allclose(residual, 2 * match.distance, atol=1e-9)


@pytest.mark.parametrize("kind", CAMERAS)
def test_slopes_are_the_derivatives_by_the_surface(kind):
    petal = jax.tree.map(jnp.asarray, PeonyPetal())
    _, term = term_at(petal, CAMERAS[kind], np.random.default_rng(1))
    uv, covectors = term.uv, term.covectors(places(petal, term.uv))
    for name in ("a_x", "dy", "c", "tip_curl"):

        def moved(value, name=name):
            return dataclasses.replace(petal, **{name: value})

        value = getattr(petal, name)
        velocity = jax.jacfwd(lambda x: moved(x)(uv[:, 0], uv[:, 1]))(value)
        h = 1e-5
        high, low = (term.residual(places(moved(value + s * h), uv)) for s in (1, -1))
        by_value = (high - low) / (2 * h)
        np.testing.assert_allclose(np.sum(covectors * velocity, axis=-1), by_value, atol=1e-6)


@pytest.mark.parametrize("kind", CAMERAS)
@pytest.mark.parametrize("name", ["a_x", "c_z", "dy", "tip_curl"])
def test_the_outline_moves_along_its_normal_as_the_slopes_say(kind, name):
    """The envelope theorem: rims and folds included, and without what (u, v) do."""
    petal, camera = PeonyPetal(dy=4.0), CAMERAS[kind]
    seen = outline(petal, camera)
    h = 0.01
    high, low = (
        outline(dataclasses.replace(petal, **{name: getattr(petal, name) + s * h}), camera)
        for s in (1, -1)
    )
    every = np.arange(len(seen.uv))
    match = Match(seen.uv, seen.place, seen.normal, seen.place, seen.length, every >= 0, every)
    contour = Contour.of(Silhouette(petal.silhouette(camera).mask, camera))
    term = term_of_rows([rows(contour, match, np.ones(len(every)))])
    covectors = term.covectors(places(petal, term.uv))
    velocity = jax.jacfwd(
        lambda x: dataclasses.replace(petal, **{name: x})(*jnp.asarray(seen.uv).T)
    )(jnp.asarray(float(getattr(petal, name))))
    predicted = np.sum(np.asarray(covectors)[: len(every)] * velocity, axis=-1)

    def offset(other):
        _, nearest = KDTree(np.c_[other.place, 5 * other.normal]).query(
            np.c_[seen.place, 5 * seen.normal]
        )
        return np.sum(seen.normal * (other.place[nearest] - seen.place), axis=-1)

    measured = (offset(high) - offset(low)) / (2 * h)
    scale = np.abs(predicted).max()
    # A few places lie where one part of the outline takes over from another.
    assert np.mean(np.abs(measured - predicted) < 0.03 * scale) > 0.9
