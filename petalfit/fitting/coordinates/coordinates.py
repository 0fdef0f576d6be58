"""The coordinates in which a fit works: unbounded, of order one, one for each free parameter."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Generic, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.components import parameters
from petalfit.surfaces import Scalar, in_doubles, leaves_of, value_at

Model = TypeVar("Model", bound=eqx.Module)
# NumPy arrays outside of compiled programs, where JAX would compile every little operation.
Numbers: TypeAlias = Array | np.ndarray


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Coordinates(Generic[Model]):
    """A bijection between ℝᵖ and the free parameters of a model inside their bounds.

    θ = middle + half·s/√(1 + s²) with s = scale·t: nearly linear away from the bounds, and a unit step
    in t is the standard deviation of the parameter's typical range. Parameters that are not free keep
    the template's values.

    Attributes:
        template: A model; its leaves are arrays.
        free: Names of the free parameters, in the model's order.
        active: 1 for a parameter that may move, 0 for one that is held for the time being.
    """

    template: Model
    free: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    middle: Float[Numbers, " p"]
    half: Float[Numbers, " p"]
    scale: Float[Numbers, " p"]
    active: Float[Numbers, " p"]

    @classmethod
    def of(cls, model: Model, free: tuple[str, ...]) -> Coordinates[Model]:
        """Coordinates of the free parameters of `model`, bounded as they are declared."""
        declared = [parameters(model)[name] for name in free]
        low, high = np.array([p.bounds for p in declared]).reshape(-1, 2).T
        typical = np.array([p.typical for p in declared]).reshape(-1, 2)
        half = 0.5 * (high - low)
        scale = (typical[:, 1] - typical[:, 0]) / np.sqrt(12) / half
        return cls(in_doubles(model), free, 0.5 * (low + high), half, scale, np.ones(len(free)))

    def around(self, model: Model) -> Coordinates[Model]:
        """The same coordinates with another template."""
        return dataclasses.replace(self, template=in_doubles(model))

    def holding(self, names: Iterable[str]) -> Coordinates[Model]:
        """The same coordinates with the named parameters held: same shapes, same compiled code."""
        active = np.array([float(name not in names) for name in self.free])
        return dataclasses.replace(self, active=active)

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the free parameters that are not held."""
        return tuple(name for name, active in zip(self.free, self.active, strict=True) if active)

    def values(self, t: Float[Numbers, "*k p"]) -> Float[Numbers, "*k p"]:
        """Parameter values at the coordinates t."""
        s = self.scale * t
        return self.middle + self.half * s * (1 + s**2) ** -0.5

    def slopes(self, t: Float[Numbers, " p"]) -> Float[Numbers, " p"]:
        """Derivatives dθ/dt at the coordinates t; zero for parameters that are held."""
        return self.active * self.half * self.scale * (1 + (self.scale * t) ** 2) ** -1.5

    def inverse(self, model: Model) -> Float[np.ndarray, " p"]:
        """Coordinates of a model's free parameters, which are first moved inside their bounds."""
        return self.place(np.array([value_at(model, name) for name in self.free], np.float64))

    def place(self, values: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... p"]:
        """Coordinates of values, which are first moved inside their bounds."""
        x = np.clip((values - self.middle) / self.half, -0.999, 0.999)
        return np.asarray(x / np.sqrt(1 - x**2) / self.scale)

    def model(self, t: Float[Numbers, " p"]) -> Model:
        """The model at the coordinates t."""
        return replaced(self.template, self.free, self.values(t))

    def spread(self, count: int) -> Float[np.ndarray, "m p"]:
        """Coordinates spread evenly over the typical ranges; held parameters stay at the template's."""
        typical = np.array([parameters(self.template)[name].typical for name in self.free])
        evenly = evenly_spread(count, len(self.free))
        values = typical[:, 0] + (typical[:, 1] - typical[:, 0]) * evenly
        return np.where(self.active > 0, self.place(values), self.inverse(self.template))

    def gather(self, tree: eqx.Module) -> Array:
        """Stacks the leaves of the free parameters, of a pytree like the model, on the last axis."""
        return gathered(tree, self.free)


def replaced(
    model: Model, names: tuple[str, ...], values: Float[Numbers, " p"] | Sequence[np.ndarray]
) -> Model:
    """The model with new values for some of its parameters."""
    leaves, structure = jax.tree.flatten(model)
    for k, place in enumerate(leaves_of(structure, names)):
        leaves[place] = values[k]
    return jax.tree.unflatten(structure, leaves)


def gathered(tree: eqx.Module, names: tuple[str, ...]) -> Array:
    """Stacks the leaves of some parameters, of a pytree like the model, on the last axis."""
    return jnp.stack([value_at(tree, name) for name in names], axis=-1)


def evenly_spread(count: int, dimension: int) -> Float[np.ndarray, "n d"]:
    """Points that fill the unit cube evenly; the first one is its middle."""
    # An additive recurrence, whose steps are powers of the root of x^(d + 1) = x + 1.
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (dimension + 1))
    steps = np.outer(np.arange(count), root ** -np.arange(1.0, dimension + 1))
    return (0.5 + steps) % 1.0


def with_values(model: Model, values: Mapping[str, Scalar | np.ndarray]) -> Model:
    """The model with some of its parameters replaced."""
    new = [np.asarray(value, np.float64) for value in values.values()]
    return replaced(model, tuple(values), new)
