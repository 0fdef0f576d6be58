"""What all suites fit: random petals as clouds and masks, and how well anybody could know them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import petalfit as pf
from petalfit.surfaces import sample_uv
from petalfit.surfaces.programs import position_and_normal
from petalfit.synthetic import random_petal

SIGMA = 0.05
NAMES = tuple(name for name, p in pf.parameters(pf.PeonyPetal).items() if not p.fixed)
# Of a petal without ribs and in its own frame: what a silhouette tells.
SMOOTH = ("a_x", "b_y", "c", "dx", "dy", "midrib_height", "tip_curl")


def petal_of(seed: int) -> pf.PeonyPetal:
    """A random petal of the ranges that the fit promises to recover."""
    return random_petal(np.random.default_rng(seed))


def cloud_of(petal: pf.PeonyPetal, n: int, seed: int, noise: float = SIGMA) -> np.ndarray:
    """Points (n, 3), area-uniform."""
    return petal.sample(n, seed=seed, noise=noise).points


def among_strays(points: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """The points, a share of them replaced by strays, which fill a box somewhat larger than theirs."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.25 * (high - low) + 0.05 * np.max(high - low)
    strays = rng.uniform(low - margin, high + margin, (round(share * len(points)), 3))
    return np.concatenate([points[: len(points) - len(strays)], strays])


class Scene(NamedTuple):
    """A petal somewhere, perhaps among clutter, and what was seen of it.

    Attributes:
        petal: The petal.
        points: Points of it and of the clutter, in random order.
        inside: Whether each point belongs to the petal.
        rotation: The rotation from the petal's frame to that of the points.
        shift: The petal's origin in that frame.
    """

    petal: pf.PeonyPetal
    points: np.ndarray
    inside: np.ndarray
    rotation: np.ndarray
    shift: np.ndarray


def seen_somewhere(
    petal: pf.PeonyPetal, uv: np.ndarray, strays: int, rng: np.random.Generator
) -> Scene:
    """A petal in a random rigid pose, seen at `uv` with noise, with strays in the box of its points."""
    with jax.enable_x64(True):
        points = np.asarray(petal(*uv.T))
    points = points + SIGMA * rng.standard_normal(points.shape)
    anywhere = rng.uniform(points.min(axis=0), points.max(axis=0), (strays, 3))
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    rotation, shift = turn * np.linalg.det(turn), rng.uniform(-50, 50, 3)
    order = rng.permutation(len(uv) + strays)
    points = np.concatenate([points, anywhere]) @ rotation.T + shift
    return Scene(petal, points[order], order < len(uv), rotation, shift)


def three_quadrants(uv: np.ndarray) -> np.ndarray:
    """The places outside of one quadrant."""
    return uv[~((uv[:, 0] > 0) & (uv[:, 1] > 0.5))]


def buried(seed: int, share: float, count: int = 2000) -> Scene:
    """A petal of which a quadrant was not seen, with clutter in its own box, in a random rigid pose.

    Args:
        seed: The number of the petal, its points and its pose.
        share: The share of all points that are clutter.
        count: Number of points of the petal.
    """
    rng = np.random.default_rng([seed, 21])
    petal = petal_of(seed)
    with jax.enable_x64(True):
        uv = three_quadrants(sample_uv(petal, 2 * count, rng))[:count]
    return seen_somewhere(petal, uv, round(count * share / (1 - share)), rng)


def off(
    petal: pf.PeonyPetal, names: tuple[str, ...], seed: int, part: float = 0.05
) -> pf.PeonyPetal:
    """The petal with each of some parameters off by a part of itself, up or down."""
    sign = np.random.default_rng([seed, 5]).choice([-1, 1], len(names))
    values = {
        n: float(getattr(petal, n)) * (1 + part * s) for n, s in zip(names, sign, strict=True)
    }
    return dataclasses.replace(petal, **values)


def errors(
    found: dict[str, float], petal: pf.PeonyPetal, names: tuple[str, ...]
) -> dict[str, float]:
    """In %."""
    return {n: 100 * abs(found[n] / float(getattr(petal, n)) - 1) for n in names}


def cramer_rao(petal: pf.PeonyPetal, n: int, seed: int, noise: float = SIGMA) -> dict[str, float]:
    """The least standard errors from n normal distances inside the petal, by exact derivatives."""

    def position(values: jax.Array, u: jax.Array, v: jax.Array) -> jax.Array:
        return dataclasses.replace(petal, **dict(zip(NAMES, values, strict=True)))(u, v)

    with jax.enable_x64(True):
        u, v = (jnp.asarray(x, float) for x in sample_uv(petal, n, np.random.default_rng(seed)).T)
        values = jnp.array([float(getattr(petal, name)) for name in NAMES])
        jacobian = jax.jit(jax.jacfwd(position))(values, u, v)
        _, normal = position_and_normal(petal, u, v)
        rows = np.asarray(jnp.einsum("nxp,nx->np", jacobian, normal)) / noise
    covariance = np.linalg.pinv(rows.T @ rows, hermitian=True)
    return dict(zip(NAMES, np.sqrt(np.diag(covariance)).tolist(), strict=True))


def oblique(petal: pf.PeonyPetal, seed: int, size: int = 256) -> pf.Camera:
    """A camera aslant before a petal that fills most of the image."""
    rng = np.random.default_rng([seed, 7])
    points = np.asarray(petal.mesh((33, 33)).vertices)
    middle = points.mean(axis=0)
    away = np.array([rng.uniform(-0.8, 0.8), rng.uniform(-1.2, -0.6), rng.uniform(0.6, 1.2)])
    camera = pf.Camera.look_at(
        tuple(middle + 60 * away), tuple(middle), (size, size), pixels_per_unit=1.0
    )
    xy = camera.project(points)
    scale = 0.84 * size / float(np.ptp(xy, axis=0).max())
    place = camera.project(np.zeros((1, 3)))[0] - xy.min(axis=0) - 0.5 * np.ptp(xy, axis=0)
    return pf.Camera.orthographic(
        camera.rotation, scale, tuple(0.5 * size + scale * place), (size, size)
    )


def mask_of(petal: pf.PeonyPetal, camera: pf.Camera) -> pf.Silhouette:
    """Binary, as a photo gives it."""
    return pf.Silhouette(np.asarray(petal.silhouette(camera).mask) > 0.5, camera)
