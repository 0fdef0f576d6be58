"""A component in a frame that is not its own."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.surfaces import WRAPPED, AbstractSurface, Domain, Scalar, parameter


class Posed(AbstractSurface):
    """unit · (scale · R S(u, v) + (shift_x, shift_y, 0)) + origin, with S of another component.

    Its parameters are the component's and its own, all by their plain names.

    Attributes:
        surface: The component.
        rotation: R, from the component's frame.
        origin: Where shifts are counted from, in the target's unit.
        unit: Length of one unit of the shifts, in the target's unit.
    """

    surface: AbstractSurface = eqx.field(metadata=WRAPPED)
    rotation: Float[Array | np.ndarray, "3 3"]
    origin: Float[Array | np.ndarray, "3"]
    unit: Scalar
    scale: Scalar = parameter(
        1.0,
        symbol="s",
        unit="1",
        bounds=(0.02, 50.0),
        typical=(0.3, 3.0),
        meaning="size of one unit of the model",
    )
    shift_x: Scalar = parameter(
        0.0,
        symbol="t_x",
        unit="length",
        bounds=(-500.0, 500.0),
        typical=(-20.0, 20.0),
        meaning="place in the image, to the right",
    )
    shift_y: Scalar = parameter(
        0.0,
        symbol="t_y",
        unit="length",
        bounds=(-500.0, 500.0),
        typical=(-20.0, 20.0),
        meaning="place in the image, downwards",
    )
    names: ClassVar[tuple[str, ...]] = ("scale", "shift_x", "shift_y")

    @property
    def domain(self) -> Domain:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.surface.domain

    @property
    def orientation(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.surface.orientation

    @property
    def edges(self) -> tuple[bool, bool]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.surface.edges

    @property
    def regular(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.surface.regular

    def position(self, u: Array, v: Array) -> Array:
        turned = self.surface.position(u, v) @ jnp.asarray(self.rotation).T
        shift = jnp.stack([jnp.asarray(self.shift_x), jnp.asarray(self.shift_y), jnp.zeros(())])
        return jnp.asarray(self.unit * (self.scale * turned + shift) + self.origin)

    def __getattr__(self, name: str) -> Any:
        # Only asked for what Posed itself does not have: the component's parameters.
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(object.__getattribute__(self, "surface"), name)

    @property
    def placement(self) -> tuple[np.ndarray, np.ndarray, float]:
        """R, t and s of X_target = s R X_component + t."""
        shift = np.array([float(self.shift_x), float(self.shift_y), 0.0])
        unit = float(self.unit)
        return (
            np.asarray(self.rotation),
            np.asarray(self.origin) + unit * shift,
            unit * float(self.scale),
        )


def bare(model: AbstractSurface) -> AbstractSurface:
    """The component itself, without a pose around it."""
    return model.surface if isinstance(model, Posed) else model
