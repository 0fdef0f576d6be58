"""Clouds of random petals, and the bound that no unbiased estimator beats."""

import jax
import numpy as np
import pytest

import petalfit as pf

SIGMA = 0.05
NAMES = [name for name, p in pf.parameters(pf.PeonyPetal).items() if not p.fixed]


def random_petal(rng):
    """A petal of the ranges that the fit promises to recover."""

    def either(low, high):
        return rng.choice([-1.0, 1.0]) * rng.uniform(low, high)

    return pf.PeonyPetal(
        a_x=rng.uniform(10, 24),
        b_y=rng.uniform(16, 40),
        c_z=rng.uniform(-1, 1),
        c=rng.uniform(0.2, 1),
        dx=either(0.15, 0.7),
        dy=rng.uniform(-5, 5),
        rib_frequency=rng.uniform(8, 32),
        rib_amplitude=rng.uniform(0.15, 0.5),
        midrib_height=rng.uniform(1, 4),
        tip_curl=rng.uniform(-3, 3),
    )


def random_blade(rng: np.random.Generator) -> pf.BladePetal:
    """A blade with numbers spread over their typical ranges."""
    return pf.BladePetal(
        width=rng.uniform(0.3, 0.8),
        widest=rng.uniform(0.35, 0.7),
        base_width=rng.uniform(0.1, 0.5),
        tip_width=rng.uniform(0.05, 0.3),
        skew=rng.uniform(-0.2, 0.2),
        bend=rng.uniform(-1.5, 1.5),
        bend_shift=rng.uniform(-0.3, 0.3),
        sickle=rng.uniform(-0.2, 0.2),
        twist=rng.uniform(-0.3, 0.3),
        cup_base=rng.uniform(0.0, 1.0),
        cup_mid=rng.uniform(0.2, 1.0),
        cup_tip=rng.uniform(0.0, 0.8),
        margin_curl=rng.uniform(-0.3, 0.3),
    )


@jax.jit
def _area_element(petal, u, v):
    return petal.area_element(u, v)


@jax.jit
def _distance_rows(petal, u, v):
    jacobian = jax.jacfwd(lambda petal: petal(u, v))(petal)
    normal = petal.normal(u, v)
    return petal(u, v), [(getattr(jacobian, name) * normal).sum(-1) for name in NAMES]


def noisy_cloud(petal, n, sigma, rng, end=1.0):
    """Area-uniform points with v below `end`, by plain rejection, and their bounds.

    The Cramér–Rao bounds are those of normal distances at the true foot points. Nothing of the package's
    sampling is used.
    """
    with jax.enable_x64(True):
        uv = rng.uniform([-0.5, 0.0], [0.5, end], (200 * max(n, 500), 2))
        density = np.asarray(_area_element(petal, *uv.T))
        kept = uv[rng.uniform(0, density.max(), len(uv)) < density][:n]
        assert len(kept) == n
        clean, rows = _distance_rows(petal, *kept.T)
        jacobian = np.stack([np.asarray(row) for row in rows], axis=-1)
    bounds = sigma * np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)))
    points = np.asarray(clean) + sigma * rng.standard_normal((n, 3))
    return points, dict(zip(NAMES, bounds, strict=True))


@pytest.fixture(scope="session")
def cloud():
    """A petal of default shape and 1,500 noisy points of it."""
    petal = pf.PeonyPetal(c_z=0.3)
    points, _ = noisy_cloud(petal, 1500, SIGMA, np.random.default_rng(11))
    return petal, points


@pytest.fixture(scope="session")
def result(cloud):
    return pf.fit_petal(cloud[1])
