"""The axis of a flower: where its petals meet, and the direction that they surround."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

_CANDIDATES = 1500
_LEAST = 0.2  # length of the mean of the petals' directions, from which it is one
_SHARED = 0.1  # weight of the mean direction beside equal inclination


class Placed(NamedTuple):
    """The places of all petals in one frame.

    Attributes:
        base: The middle of each petal's base, shape (k, 3).
        middle: The middle of each petal's surface, shape (k, 3).
    """

    base: Float[np.ndarray, "k 3"]
    middle: Float[np.ndarray, "k 3"]

    @property
    def direction(self) -> Float[np.ndarray, "k 3"]:
        """The unit vectors from the bases to the middles."""
        way = self.middle - self.base
        return way / np.linalg.norm(way, axis=1, keepdims=True)

    def without(self, k: int) -> Placed:
        """The places of all petals but one."""
        return Placed(np.delete(self.base, k, axis=0), np.delete(self.middle, k, axis=0))


def meeting_point(segments: Sequence[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "3"]:
    """The point of several segments that is the nearest to all of them: petals meet at their bases."""
    every = np.concatenate(segments)
    some = every[:: max(1, len(every) // _CANDIDATES)]
    away = sum(np.asarray(KDTree(segment).query(some)[0]) for segment in segments)
    return some[int(np.argmin(away))]


class Axis(NamedTuple):
    """The frame of a flower and how sure its axis is.

    Attributes:
        axes: The frame's axes as columns; y is the flower's axis.
        origin: Its origin, in the middle of the petals' bases.
        stderr: The standard error of the y axis in rad, which is infinite for fewer than four petals: of
            two that are left, no axis is known.
    """

    axes: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, "3"]
    stderr: float


def axes_of(placed: Placed) -> list[Axis]:
    """Two guesses of the axis of a flower, of which the arrangement of the petals shows the better one.

    The first is the direction to which all petals are inclined by the most equal angles: right for one
    whorl, even if petals are missing. The second is their mean direction: right for several whorls of
    different angles, as long as each is complete.
    """
    return [_axis(placed, common) for common in (_equally_inclined, _mean)]


def _axis(placed: Placed, common: Callable[[Placed], Float[np.ndarray, "3"]]) -> Axis:
    y = common(placed)
    count, error = len(placed.base), np.inf
    if count >= 4:
        others = np.stack([common(placed.without(k)) for k in range(count)])
        angles = np.arccos(np.clip(others @ y, -1, 1))
        error = float(np.sqrt((count - 1) / count * np.sum(angles**2)))  # the jackknife
    outwards = placed.middle[0] - placed.base[0]
    x = outwards - (outwards @ y) * y
    if np.linalg.norm(x) < 1e-6 * np.linalg.norm(outwards):
        x = np.eye(3)[int(np.argmin(np.abs(y)))]
        x = x - (x @ y) * y
    x = x / np.linalg.norm(x)
    axes = np.stack([x, y, np.cross(x, y)], axis=-1)
    return Axis(axes, placed.base.mean(axis=0), error)


def _mean(placed: Placed) -> Float[np.ndarray, "3"]:
    mean = placed.direction.mean(axis=0)
    long = np.linalg.norm(mean)
    # Petals at right angles to their axis have no mean direction.
    return mean / long if long > _LEAST else _equally_inclined(placed)


def _equally_inclined(placed: Placed) -> Float[np.ndarray, "3"]:
    direction = placed.direction
    mean = direction.mean(axis=0)
    spread = direction - mean
    form = _SHARED * np.outer(mean, mean) - spread.T @ spread / len(direction)
    y = np.linalg.eigh(form)[1][:, -1]
    return y if y @ mean >= 0 else -y
