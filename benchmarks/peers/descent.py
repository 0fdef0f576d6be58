"""What the gradient-descent peers share: the projected mesh of a petal, Adam, and when to stop.

Both peers see the same mesh, the same scaled parameters and the same optimiser; they differ only in how
they turn projected vertices into a loss and its gradient. Adam's step is halved whenever the loss has
stopped falling, and the answer is the mean of the last window of iterates, so noise in the gradient
(Mitsuba's is a Monte-Carlo estimate) costs neither accuracy nor steps. The first evaluation, which
compiles, is not timed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

import petalfit as pf
from benchmarks.peers.found import Found

MESH = (129, 65)
RATE = 0.02
MOST_STEPS = 1000
WINDOW = 10  # steps between two looks at the loss
PATIENCE = 0.01  # relative fall of the loss between two windows that counts as progress
HALVINGS = 5  # of the rate, then it has converged

# The loss and its gradient at scaled parameters; a step's number, for what is random in it.
Gradient: TypeAlias = Callable[[np.ndarray, int], tuple[float, np.ndarray]]


class ProjectedPetal:
    """The vertices of a petal's mesh in the image, as a function of its scaled free parameters.

    A free parameter is its start plus its scale times z; the scale is half its typical range.
    """

    def __init__(self, start: pf.PeonyPetal, camera: pf.Camera, free: tuple[str, ...]) -> None:
        self.camera, self.free = camera, free
        declared = pf.parameters(pf.PeonyPetal)
        self.start = np.array([float(getattr(start, name)) for name in free])
        self.scale = np.array([0.5 * np.ptp(declared[name].typical) for name in free])
        u, v = (jnp.linspace(*side, n) for side, n in zip(start.domain, MESH, strict=True))
        matrix, axis = jnp.asarray(camera.matrix), jnp.asarray(camera.rotation[2])

        def project(z: jax.Array) -> tuple[jax.Array, jax.Array]:
            values = dict(zip(free, self.start + self.scale * z, strict=True))
            points = replace(start, **values)(u[:, None], v[None, :])
            seen = points @ matrix[:, :3].T + matrix[:, 3]
            return seen[..., :2] / seen[..., 2:], points @ axis + camera.translation[2]

        self.project = project

    def values(self, z: np.ndarray) -> np.ndarray:
        """The free parameters themselves."""
        return self.start + self.scale * z


def grid_faces() -> np.ndarray:
    """Triangles (f, 3) of the mesh's grid, all with the same sense in (u, v)."""
    i = np.arange(MESH[0] * MESH[1]).reshape(MESH)
    a, b, c, d = (x.ravel() for x in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def fit_mask(
    gradient_of: Callable[[np.ndarray, ProjectedPetal], Gradient],
    mask: np.ndarray,
    camera: pf.Camera,
    start: pf.PeonyPetal,
    free: tuple[str, ...],
    seconds_limit: float,
) -> Found:
    """Fits the free parameters to a mask.

    Args:
        gradient_of: The peer's: the loss and its gradient at z, of a mask and a petal.
        mask: (H, W), bool.
        camera: Of the mask.
        start: Where Adam starts; what is not free stays.
        free: Names of the parameters to fit.
        seconds_limit: Most seconds, without compilation.
    """
    petal = ProjectedPetal(start, camera, free)
    gradient, z = gradient_of(mask, petal), np.zeros(len(free))
    gradient(z, 0)  # compiles
    first, second, tail, losses = np.zeros_like(z), np.zeros_like(z), [], []
    halvings, before, began = 0, np.inf, time.perf_counter()
    for step in range(1, MOST_STEPS + 1):
        loss, slope = gradient(z, step)
        first = 0.9 * first + 0.1 * slope
        second = 0.99 * second + 0.01 * slope**2
        corrected = first / (1 - 0.9**step), np.sqrt(second / (1 - 0.99**step))
        z = z - RATE * 0.5**halvings * corrected[0] / (corrected[1] + 1e-12)
        tail = [*tail[1 - WINDOW :], z]
        losses.append(float(loss))
        if step % WINDOW == 0:
            now = np.mean(losses[-WINDOW:])
            halvings += now > (1 - PATIENCE) * before
            before = now
        seconds = time.perf_counter() - began
        if halvings == HALVINGS or seconds > seconds_limit:
            break
    found = petal.values(np.mean(tail, axis=0)).tolist()
    values = dict(zip(free, found, strict=True))
    return Found(values, seconds, step, bool(halvings == HALVINGS))
