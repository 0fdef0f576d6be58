"""Poses: similarities from one frame to another."""

from __future__ import annotations

from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.surfaces.map import Scalar

Numbers: TypeAlias = Array | np.ndarray


class Pose(eqx.Module):
    """A similarity from the model's frame to the target's: x_target = scale · R x_model + t.

    Arrays may have leading axes, for a batch of poses.

    Attributes:
        rotation: The rotation R from the model's frame to the target's, shape (..., 3, 3).
        translation: t, shape (..., 3), in the target's unit.
        scale: The scale, positive, shape (...).
    """

    rotation: Float[Numbers, "*batch 3 3"]
    translation: Float[Numbers, "*batch 3"]
    scale: float | Float[Numbers, "*batch"]

    @classmethod
    def identity(cls) -> Pose:
        """The pose of a target that is already in the model's frame."""
        return cls(np.eye(3), np.zeros(3), 1.0)

    @classmethod
    def at(cls, x: Scalar, y: Scalar, z: Scalar) -> Pose:
        """A pure translation to the place (x, y, z)."""
        place = jnp.stack([jnp.asarray(part, float) for part in (x, y, z)])
        return cls(np.eye(3), place, 1.0)

    def __call__(self, points: Float[Numbers, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """Maps points from the model's frame to the target's; for a pose without leading axes."""
        turned = jnp.asarray(points) @ jnp.asarray(self.rotation).T
        return jnp.asarray(self.scale * turned + self.translation)

    def into(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Maps points from the target's frame to the model's; for a pose without leading axes."""
        turned = (points - np.asarray(self.translation)) @ np.asarray(self.rotation)
        return turned / float(self.scale)

    def __matmul__(self, inner: Pose) -> Pose:
        """The composition that applies `inner` first, then this pose; neither has leading axes."""
        return Pose(
            jnp.asarray(self.rotation) @ inner.rotation,
            self(inner.translation),
            jnp.asarray(self.scale * inner.scale),
        )

    def matrix(self) -> Float[np.ndarray, "*batch 4 4"]:
        """The pose as homogeneous matrices, shape (..., 4, 4)."""
        rotation = np.asarray(self.rotation)
        matrix = np.zeros((*rotation.shape[:-2], 4, 4))
        matrix[..., :3, :3] = np.asarray(self.scale)[..., None, None] * rotation
        matrix[..., :3, 3] = self.translation
        matrix[..., 3, 3] = 1.0
        return matrix


def turn_between(one: Float[Numbers, "3 3"], other: Float[Numbers, "3 3"]) -> float:
    """The angle of the rotation from one frame to another, in rad."""
    cosine = 0.5 * (np.trace(np.asarray(one).T @ np.asarray(other)) - 1)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def rotation(turn: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The rotation about a vector by its length in rad; its derivatives at zero are finite."""
    squared = jnp.sum(turn**2)
    small = squared < 1e-8
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    # Rodrigues' coefficients sin(a)/a and (1 - cos a)/a².
    first = jnp.where(small, 1 - squared / 6, jnp.sin(angle) / angle)
    second = jnp.where(small, 0.5 - squared / 24, (1 - jnp.cos(angle)) / angle**2)
    x, y, z = jnp.unstack(turn)
    zero = jnp.zeros(())
    skew = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    return jnp.eye(3) + first * skew + second * skew @ skew


def about_x(angle: Scalar) -> Float[Array, "3 3"]:
    """The rotation about x, from y towards z; `angle` in rad, a scalar."""
    cosine, sine, one = jnp.cos(angle), jnp.sin(angle), jnp.ones(())
    zero = jnp.zeros(())
    return jnp.stack(
        [
            jnp.stack([one, zero, zero]),
            jnp.stack([zero, cosine, -sine]),
            jnp.stack([zero, sine, cosine]),
        ]
    )


def about_y(angle: Scalar) -> Float[Array, "3 3"]:
    """The rotation about y, from z towards x; `angle` in rad, a scalar."""
    cosine, sine, one = jnp.cos(angle), jnp.sin(angle), jnp.ones(())
    zero = jnp.zeros(())
    return jnp.stack(
        [
            jnp.stack([cosine, zero, sine]),
            jnp.stack([zero, one, zero]),
            jnp.stack([-sine, zero, cosine]),
        ]
    )
