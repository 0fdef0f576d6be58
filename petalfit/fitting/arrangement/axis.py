"""The axis of a flower: the direction that its petals surround, and how they stand about it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from petalfit.surfaces import Pose

_LEAST = 0.2  # length of the mean of the petals' directions, from which it is one
_SHARED = 0.1  # weight of the mean direction beside equal inclination


class Placed(NamedTuple):
    """The places of all petals in one frame.

    Attributes:
        base: The middle of each petal's base, shape (k, 3).
        middle: The middle of each petal's surface, shape (k, 3).
        along: The unit vector along which each petal leaves its base, shape (k, 3).
    """

    base: Float[np.ndarray, "k 3"]
    middle: Float[np.ndarray, "k 3"]
    along: Float[np.ndarray, "k 3"]

    @property
    def direction(self) -> Float[np.ndarray, "k 3"]:
        """The unit vectors from the bases to the middles."""
        way = self.middle - self.base
        return way / np.linalg.norm(way, axis=1, keepdims=True)

    def without(self, k: int) -> Placed:
        """The places of all petals but one."""
        return Placed(*(np.delete(places, k, axis=0) for places in self))


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

    def about(self, placed: Placed) -> About:
        """How petals stand about the axis."""
        middle = (placed.middle - self.origin) @ self.axes
        base = (placed.base - self.origin) @ self.axes
        return About(
            np.arctan2(middle[:, 2], middle[:, 0]),
            np.hypot(middle[:, 0], middle[:, 2]),
            _inclined(middle - base),
            _inclined(placed.along @ self.axes),
            base[:, 1],
        )

    def upright(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
        """The distances of points from the axis, and their heights along it."""
        own = (points - self.origin) @ self.axes
        return np.stack([np.hypot(own[:, 0], own[:, 2]), own[:, 1]], axis=-1)

    def turning(self, one: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> Pose:
        """The turn about the axis that brings one place to the azimuth of another."""
        (x, _, z), (a, _, b) = ((place - self.origin) @ self.axes for place in (one, other))
        angle = np.arctan2(z, x) - np.arctan2(b, a)  # y turns z towards x
        turn = Rotation.from_rotvec(angle * self.axes[:, 1]).as_matrix()
        return Pose(turn, self.origin - turn @ self.origin, 1.0)

    def moved(self, by: Float[np.ndarray, "4"]) -> Axis:
        """The axis turned about its x and z axes, in rad, and moved along them."""
        turn = Rotation.from_rotvec([by[0], 0.0, by[1]]).as_matrix()
        shift = self.axes @ np.array([by[2], 0.0, by[3]])
        return Axis(self.axes @ turn, self.origin + shift, self.stderr)


class About(NamedTuple):
    """How the petals of a flower stand about its axis.

    Attributes:
        azimuth: The angles of their middles about the axis, in rad, from x towards z, shape (k,).
        radius: The distances of their middles from the axis, shape (k,).
        inclination: The angles between the axis and the ways from their bases to their middles, in rad,
            shape (k,).
        opening: The angles between the axis and the directions in which they leave their bases, in rad,
            shape (k,).
        height: The heights of their bases along the axis, shape (k,).
    """

    azimuth: Float[np.ndarray, " k"]
    radius: Float[np.ndarray, " k"]
    inclination: Float[np.ndarray, " k"]
    opening: Float[np.ndarray, " k"]
    height: Float[np.ndarray, " k"]


def wrapped(angle: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
    """The same angles, from −π to π."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def _inclined(way: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
    return np.arctan2(np.hypot(way[:, 0], way[:, 2]), way[:, 1])


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
