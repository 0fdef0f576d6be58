"""Starts of any component: shapes that reach as far as a cloud in all directions of space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.observed import AbstractObserved
from petalfit.fitting.solver.alternate import minimise
from petalfit.fitting.solver.observer import report
from petalfit.fitting.starts.support import Shadow, search
from petalfit.surfaces import AbstractSurface

_FLAT = np.array([[0.0, 0.0, 0.0, 1.0]])  # the last row of an orthographic camera
_CANDIDATES = 12
_FOLLOWED = 2
_SAME = 0.3  # two starts count as the same if no coordinate differs by more


def extent_starts(
    coordinates: Coordinates,
    observe: Callable[[np.ndarray, np.ndarray, float | None], AbstractObserved],
    points: np.ndarray,
    weights: np.ndarray,
) -> list[tuple[str, AbstractSurface]]:
    """Starts of any component, which reach as far as the points in all directions.

    Args:
        coordinates: The free parameters.
        observe: A function that makes the likelihood of points, given their weights and noise.
        points: Some points of the cloud, shape (n, 3).
        weights: The number of observations that each point counts for, shape (n,).

    Returns:
        Different starts with their labels, the best first.
    """
    report("searching the extent")
    # Three views along the axes show how far a body reaches in space.
    shadows = [
        Shadow(np.vstack([np.hstack([np.delete(np.eye(3), k, 0), np.zeros((2, 1))]), _FLAT]),
               np.delete(points, k, 1), weights)
        for k in range(3)
    ]  # fmt: skip
    cloud = observe(points, weights, None)
    found = []
    for t, _ in search(coordinates, shadows, _CANDIDATES):
        model = minimise(coordinates, [cloud], coordinates.model(t), [None], 4, 0.5).model
        found.append((cloud.misfit(model), model))
    found.sort(key=lambda start: start[0])
    different: list[tuple[str, AbstractSurface]] = []
    for _, model in found:
        t = coordinates.inverse(model)
        apart = [np.max(np.abs(t - coordinates.inverse(other))) > _SAME for _, other in different]
        if all(apart):
            different.append((f"extent {len(different) + 1}", model))
        if len(different) == _FOLLOWED:
            break
    return different
