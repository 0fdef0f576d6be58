"""What residuals need of a surface at many places, in few compiled programs that surfaces share.

They take and return arrays of NumPy, whose rows go through in blocks of one size, so that no number of
rows compiles anything. A posed component is computed in its own frame, with the programs of the bare one.
Call them inside `jax.enable_x64(True)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from petalfit.compilation import RowProgram
from petalfit.components import Posed
from petalfit.residuals.contact import Frame, Numbers, frame, pull_back
from petalfit.residuals.foot_point import newton
from petalfit.surfaces import AbstractMap, AbstractSurface, in_doubles, leaves_of

_OF_FRAME = (3,), (3,), (2, 3), (2,), (2,), ()  # shapes of its fields for one place
_NODES = 17  # per side of the domain
_AT_ONCE = 4096  # points
_SMALL = 1e-8  # rad, below which the derivatives of a turn are those at none


def places(surface: AbstractMap, uv: Float[Numbers, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Positions on a surface."""
    if isinstance(surface, Posed):
        turn, shift, scale = surface.similarity_in_numpy
        return places(surface.surface, uv) @ (scale * turn.T) + shift
    return _places(in_doubles(surface), uv)


def frames(surface: AbstractSurface, uv: Float[Numbers, "n 2"]) -> Frame:
    """The frames of a surface at foot points."""
    if not isinstance(surface, Posed):
        return Frame(*_split(_frames(in_doubles(surface), uv), _OF_FRAME))
    here, (turn, shift, scale) = frames(surface.surface, uv), surface.similarity_in_numpy
    return Frame(
        here.position @ (scale * turn.T) + shift,
        here.normal @ turn.T,
        here.conormals @ turn.T,
        here.left * scale,
        here.speed * scale,
        here.area_element * scale * scale,
    )


def nearest_nodes(surface: AbstractMap, points: Float[Numbers, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """The nearest of 17 × 17 places of the domain for each point: coarse starts of foot points."""
    low, high = np.array(surface.domain).T
    fraction = (np.arange(_NODES) + 0.5) / _NODES
    share = np.stack(np.meshgrid(fraction, fraction, indexing="ij"), axis=-1).reshape(-1, 2)
    uv = low + (high - low) * share
    nodes = places(surface, uv)
    squares, points = np.sum(nodes**2, axis=-1), np.asarray(points)
    # All squared distances of a large cloud at once would take gigabytes.
    some = np.split(points, range(_AT_ONCE, len(points), _AT_ONCE))
    return uv[np.concatenate([np.argmin(squares - 2.0 * x @ nodes.T, axis=-1) for x in some])]


def slide_foot_points(
    surface: AbstractMap,
    points: Float[Numbers, "n 3"],
    uv: Float[Numbers, "n 2"],
    iterations: int,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Refines foot points within their own local minima, by damped steps of Newton's method.

    Returns:
        The foot points, a number for how doubtful each is (see `least_places`), and half the squared
        distances, by the unit of the component.
    """
    if isinstance(surface, Posed):
        return slide_foot_points(surface.surface, _into(surface, points), uv, iterations)
    rows = _slide(in_doubles(surface), np.float64(iterations), points, uv)
    uv, doubt, squared = _split(rows, ((2,), (), ()))
    return uv, doubt, squared


def pulled(
    surface: AbstractSurface,
    uv: Float[Numbers, "n 2"],
    covectors: Float[np.ndarray, "n 3"],
    names: Sequence[str],
    position: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n p"]:
    """The derivatives of w·S(u, v) by named parameters, for every place and its covector w.

    Args:
        surface: The surface.
        uv: The places, shape (n, 2).
        covectors: The covectors w, shape (n, 3).
        names: Names of the parameters.
        position: The positions S of the places, shape (n, 3).
    """
    some = np.any(covectors != 0, axis=1)
    if np.all(some):
        return _pulled_by(surface, np.asarray(uv), covectors, names, position)
    found = np.zeros((len(covectors), len(names)))
    uv, covectors, position = np.asarray(uv)[some], covectors[some], position[some]
    found[some] = _pulled_by(surface, uv, covectors, names, position)
    return found


def _pulled_by(
    surface: AbstractSurface,
    uv: np.ndarray,
    covectors: np.ndarray,
    names: Sequence[str],
    position: np.ndarray,
) -> Float[np.ndarray, "n p"]:
    if not isinstance(surface, Posed):
        rows = _pulled(in_doubles(surface), uv, covectors)
        return rows[:, _columns(surface, names)]
    (turn, _, scale), unit = surface.similarity_in_numpy, float(surface.unit)
    own = [name for name in names if name not in Posed.similarity]
    here = _into(surface, position)
    inner = _pulled_by(surface.surface, uv, scale * covectors @ turn, own, here)
    found = dict(zip(own, inner.T, strict=True))
    found |= zip(Posed.rigid[:3], unit * covectors.T, strict=True)  # the shifts
    found["scale"] = unit * np.sum(covectors * (here @ turn.T), axis=1)
    fixed = np.asarray(surface.rotation)
    for name, slope in zip(Posed.rigid[3:], _by_turn(surface), strict=True):
        found[name] = scale * np.sum(covectors * (here @ (fixed @ slope).T), axis=1)
    return np.stack([found[name] for name in names], axis=-1)


def _columns(surface: AbstractSurface, names: Sequence[str]) -> Int[np.ndarray, " p"]:
    """The columns of `_pull_back` that belong to parameters."""
    leaves, structure = jax.tree.flatten(surface)
    first = np.cumsum([0, *map(np.size, leaves)])
    return first[list(leaves_of(structure, tuple(names)))]


def _into(posed: Posed, points: Float[Numbers, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Points in the frame of a posed component."""
    turn, shift, scale = posed.similarity_in_numpy
    return (np.asarray(points) - shift) @ (turn / scale)


def _by_turn(posed: Posed) -> Float[np.ndarray, "3 3 3"]:
    """The derivatives of the rotation T by the components of its vector.

    The formula is that of Gallego and Yezzi (J. Math. Imaging Vis. 51, 2015).
    """
    turn = np.array([float(posed.turn_x), float(posed.turn_y), float(posed.turn_z)])
    about = Rotation.from_rotvec(turn).as_matrix()
    square = float(turn @ turn)
    axes = np.eye(3)
    if square < _SMALL**2:
        return np.stack([_cross(axis) for axis in axes])
    left = [turn[k] * turn + np.cross(turn, (axes - about)[:, k]) for k in range(3)]
    return np.stack([_cross(vector / square) @ about for vector in left])


def _cross(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The matrix that multiplies by the vector product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _split(rows: np.ndarray, shapes: Sequence[tuple[int, ...]]) -> tuple[np.ndarray, ...]:
    """The arrays of which `_joined` has made rows, of which each row had such a shape."""
    ends = np.cumsum([0, *(np.prod(shape, dtype=int) for shape in shapes)])
    parts = zip(pairwise(ends), shapes, strict=True)
    return tuple(rows[:, a:b].reshape(-1, *shape) for (a, b), shape in parts)


def _joined(arrays: Any) -> Float[Array, "n k"]:
    """Arrays in one, side by side: each result of a program takes time."""
    leaves = jax.tree.leaves(arrays)
    return jnp.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)


def _position(surface: AbstractMap, uv: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    return surface.position(uv[:, 0], uv[:, 1])


def _frame(surface: AbstractSurface, uv: Float[Array, "n 2"]) -> Float[Array, "n 17"]:
    return _joined(frame(surface, uv))


def _slid(
    surface: AbstractMap,
    iterations: Float[Array, ""],
    points: Float[Array, "n 3"],
    uv: Float[Array, "n 2"],
) -> Float[Array, "n 4"]:
    return _joined(newton(surface, points, uv, iterations.astype(int)))


def _pull_back(
    surface: AbstractSurface, uv: Float[Array, "n 2"], covectors: Float[Array, "n 3"]
) -> Float[Array, "n k"]:
    return _joined(pull_back(surface, uv, covectors))


_places, _frames = RowProgram(_position, 1), RowProgram(_frame, 1)
_slide, _pulled = RowProgram(_slid, 2), RowProgram(_pull_back, 2)
