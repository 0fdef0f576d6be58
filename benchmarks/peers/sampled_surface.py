"""scipy.optimize.least_squares and lmfit on a sampled surface: what one writes in an afternoon.

The petal is sampled on a grid, a k-d tree finds the nearest sample of every point, and the residuals are
the three coordinates of the difference. A fair peer: the petal is evaluated by NumPy without any
overhead, parameters are scaled by their typical range, the noise of the grid is below the data's, and the
start is 5 % off, whereas petalfit has none.

`fit_scipy_jacobian` gives the solver what the afternoon does not: normal distances at the tree's nearest
samples and their exact derivatives, by petalfit's own compiled surface.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import metadata

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

import petalfit as pf
from benchmarks.peers.found import Found

GRID = 200
NAMES = tuple(name for name, p in pf.parameters(pf.PeonyPetal).items() if not p.fixed)
SCALES = np.array([0.5 * np.ptp(pf.parameters(pf.PeonyPetal)[name].typical) for name in NAMES])


def fit_scipy(points: np.ndarray, start: pf.PeonyPetal) -> Found:
    """Finite differences."""
    began = time.perf_counter()
    origin = values_of(start)
    solution = least_squares(_residuals(points), origin / SCALES, method="trf", x_scale=1.0)
    seconds = time.perf_counter() - began
    return Found(dict(zip(NAMES, solution.x * SCALES, strict=True)), seconds, int(solution.nfev))


def fit_scipy_jacobian(points: np.ndarray, start: pf.PeonyPetal) -> Found:
    """Normal distances with petalfit's derivatives."""
    import jax

    with jax.enable_x64(True):
        program = jax.jit(_distances)
        slopes = jax.jit(jax.jacfwd(lambda z, uv: _distances(z, uv, points)[0]))
        grid = _grid()
        place = {}

        def residuals(z: np.ndarray) -> np.ndarray:
            surface = numpy_petal(z * SCALES, *grid.T)
            nearest = cKDTree(surface).query(points)[1]
            place["uv"] = grid[nearest]
            return np.asarray(program(z, place["uv"], points)[0])

        def jacobian(z: np.ndarray) -> np.ndarray:
            return np.asarray(slopes(z, place["uv"]))

        origin = values_of(start) / SCALES
        residuals(origin), jacobian(origin)  # compiles
        began = time.perf_counter()
        solution = least_squares(residuals, origin, jac=jacobian, method="trf")  # pyright: ignore[reportArgumentType]
        seconds = time.perf_counter() - began
    return Found(dict(zip(NAMES, solution.x * SCALES, strict=True)), seconds, int(solution.nfev))


def fit_lmfit(points: np.ndarray, start: pf.PeonyPetal) -> Found:
    """Lmfit's leastsq, which is MINPACK with bounds and a table."""
    import lmfit

    parameters = lmfit.Parameters()
    for name, value, scale in zip(NAMES, values_of(start), SCALES, strict=True):
        parameters.add(name, value=value / scale)
    residuals = _residuals(points)
    began = time.perf_counter()
    solution = lmfit.minimize(
        lambda p: residuals(np.array([p[name].value for name in NAMES])), parameters
    )
    seconds = time.perf_counter() - began
    found = np.array([solution.params[name].value for name in NAMES])
    return Found(dict(zip(NAMES, found * SCALES, strict=True)), seconds, int(solution.nfev))


def lmfit_name() -> str:
    """With its version."""
    return f"lmfit {metadata.version('lmfit')}"


def values_of(petal: pf.PeonyPetal) -> np.ndarray:
    """Of the free parameters."""
    return np.array([float(getattr(petal, name)) for name in NAMES])


def numpy_petal(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Eq. 8 in NumPy."""
    a_x, b_y, c_z, c, dx, dy, frequency, amplitude, midrib, curl = values
    x = a_x * u + 0.8 * a_x * u * np.sin(np.pi * v / 2 - c)
    scallop = np.abs(3 * v * np.sin(np.pi * a_x * (u + 0.5) / 6))
    y = b_y * v + (v - 0.5) * (1.5 * a_x * np.sin(np.pi * (u + 0.5)) + scallop)
    envelope = (1 - 2 * np.abs(v - 0.5)) * (1 - 2 * np.abs(u))
    height = amplitude * envelope * np.sin(frequency * (u + 0.5) * np.pi)
    height = height + midrib * (1 - v) ** 2 * np.exp(-800 * u**2)
    height = height + dy * np.sin(np.pi * y / 40 - 1) + dx * np.sin(np.pi * x / 2 - 0.5)
    height = height + curl * v**3 * np.sin(np.pi * x / 8)
    return np.stack([x, y, c_z + height], axis=-1)


def _grid() -> np.ndarray:
    side = (np.arange(GRID) + 0.5) / GRID
    return np.stack(np.meshgrid(side - 0.5, side, indexing="ij"), axis=-1).reshape(-1, 2)


def _residuals(points: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    u, v = _grid().T

    def residuals(z: np.ndarray) -> np.ndarray:
        surface = numpy_petal(z * SCALES, u, v)
        nearest = cKDTree(surface).query(points)[1]
        return (surface[nearest] - points).ravel()

    return residuals


def _distances(z: np.ndarray, uv: np.ndarray, points: np.ndarray) -> tuple:
    import jax

    petal = pf.PeonyPetal(**dict(zip(NAMES, z * SCALES, strict=True)))
    normal = jax.lax.stop_gradient(petal.normal(uv[:, 0], uv[:, 1]))
    return (normal * (petal(uv[:, 0], uv[:, 1]) - points)).sum(axis=-1), normal
