"""A component posed in another frame, with its pose as parameters."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.components.carrier import AbstractCarrier
from petalfit.surfaces import (
    WRAPPED,
    AbstractSurface,
    Pose,
    Scalar,
    angle,
    length,
    number,
    rotation,
)


def _shift(axis: str) -> Any:
    meaning = f"place, along {axis} (in an image x is to the right and y downwards)"
    return length(0.0, f"t_{axis}", (-500.0, 500.0), (-20.0, 20.0), meaning)


def _turn(axis: str) -> Any:
    meaning = f"turn about the component's {axis}"
    return angle(0.0, f"ω_{axis}", (-3.2, 3.2), (-1.0, 1.0), meaning)


class Posed(AbstractCarrier):
    """A component S with a pose: unit · (scale · R T S(u, v) + shift) + origin.

    Its parameters are those of the component and of the pose, all by their plain names. T is the rotation
    by the vector (turn_x, turn_y, turn_z): about its direction, by its length in rad.

    Attributes:
        surface: The component.
        rotation: R, a fixed rotation that is applied after T, shape (3, 3).
        origin: The place that shifts are counted from, in the target's unit, shape (3,).
        unit: The length of one unit of the shifts, in the target's unit.
    """

    surface: AbstractSurface = eqx.field(metadata=WRAPPED)
    rotation: Float[Array | np.ndarray, "3 3"]
    origin: Float[Array | np.ndarray, "3"]
    unit: Scalar
    scale: Scalar = number(1.0, "s", (0.02, 50.0), (0.3, 3.0), "size of one unit of the model")
    shift_x: Scalar = _shift("x")
    shift_y: Scalar = _shift("y")
    shift_z: Scalar = _shift("z")
    turn_x: Scalar = _turn("x")
    turn_y: Scalar = _turn("y")
    turn_z: Scalar = _turn("z")
    model_field: ClassVar[str] = "surface"
    # The parameters that are free in an image of unknown place and scale, and those free in space.
    in_image: ClassVar[tuple[str, ...]] = ("scale", "shift_x", "shift_y", "turn_z")
    rigid: ClassVar[tuple[str, ...]] = (
        "shift_x",
        "shift_y",
        "shift_z",
        "turn_x",
        "turn_y",
        "turn_z",
    )
    similarity: ClassVar[tuple[str, ...]] = ("scale", *rigid)

    @classmethod
    def free_in(cls, pose: str) -> tuple[str, ...]:
        """The names of the free parameters of a pose that is "known", "rigid" or "similarity"."""
        return {"known": (), "rigid": cls.rigid, "similarity": cls.similarity}[pose]

    @property
    def carried(self) -> AbstractSurface:
        return self.surface

    def position(self, u: Array, v: Array) -> Array:
        shift = jnp.stack([jnp.asarray(x) for x in (self.shift_x, self.shift_y, self.shift_z)])
        turned = self.surface.position(u, v) @ self.turned.T
        return jnp.asarray(self.unit * (self.scale * turned + shift) + self.origin)

    @property
    def turned(self) -> Float[Array, "3 3"]:
        """The rotation R T from the component's frame to the target's."""
        turn = jnp.stack([jnp.asarray(x) for x in (self.turn_x, self.turn_y, self.turn_z)])
        return jnp.asarray(self.rotation) @ rotation(turn)

    @property
    def placement(self) -> Pose:
        """The pose from the component's frame to the target's."""
        return Pose(*self.similarity_in_numpy)

    @property
    def similarity_in_numpy(self) -> tuple[np.ndarray, np.ndarray, float]:
        """The rotation, the translation and the scale of the pose, which take less time than it does."""
        from scipy.spatial.transform import Rotation

        shift = np.array([self.shift_x, self.shift_y, self.shift_z], float)
        turn = np.array([self.turn_x, self.turn_y, self.turn_z], float)
        turned = np.asarray(self.rotation) @ Rotation.from_rotvec(turn).as_matrix()
        unit = float(self.unit)
        return turned, np.asarray(self.origin) + unit * shift, unit * float(self.scale)

    def at_rest(self, surface: AbstractSurface) -> Posed:
        """Another surface in the same pose, which becomes the frame: all turns and shifts are 0."""
        placed = self.placement
        place = np.asarray(placed.translation, np.float64)
        return Posed(surface, np.asarray(placed.rotation), place, np.float64(placed.scale))

    def seen_from(self, other: Posed) -> Posed:
        """The same surface at the same place, with turns and shifts counted in the frame of `other`."""
        from scipy.spatial.transform import Rotation

        placed = self.placement
        apart = np.asarray(other.rotation).T @ np.asarray(placed.rotation)
        turn = Rotation.from_matrix(apart).as_rotvec()
        shift = (np.asarray(placed.translation) - np.asarray(other.origin)) / float(other.unit)
        scale = placed.scale / float(other.unit)
        return Posed(self.surface, other.rotation, other.origin, other.unit, scale, *shift, *turn)


def bare(model: AbstractSurface) -> AbstractSurface:
    """The component itself, without its pose if it has one."""
    return model.surface if isinstance(model, Posed) else model
