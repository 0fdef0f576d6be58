"""Coordinates in a box: the free parameters themselves, in units of their typical spreads."""

from __future__ import annotations

import dataclasses
from typing import Generic

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from petalfit.components import parameters
from petalfit.fitting.coordinates.coordinates import (
    Model,
    Numbers,
    gathered,
    replaced,
)
from petalfit.surfaces import in_doubles, value_at

# A positive parameter whose typical range spans a greater factor is taken by its logarithm.
_WIDE = 4.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Box(Generic[Model]):
    """The free parameters of a model, divided by the standard deviations of their typical ranges.

    Positive parameters with a wide typical range are taken by their logarithms. Unlike `Coordinates` all
    may lie on a bound, where solvers hold them.

    Attributes:
        template: A model; its leaves are arrays.
        free: Names of the free parameters, in the model's order.
        logs: Whether each of them is taken by its logarithm, shape (p,).
        spread: Standard deviations of the typical ranges, taken as uniform, shape (p,).
        low: Lower bounds, in units of the spread, shape (p,).
        high: Upper bounds, in units of the spread, shape (p,).
    """

    template: Model
    free: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    logs: Bool[Numbers, " p"]
    spread: Float[Numbers, " p"]
    low: Float[Numbers, " p"]
    high: Float[Numbers, " p"]

    @classmethod
    def of(cls, model: Model, free: tuple[str, ...]) -> Box[Model]:
        """The box of the free parameters of `model`, as they are declared."""
        declared = [parameters(model)[name] for name in free]
        typical = np.array([p.typical for p in declared])
        bounds = np.array([p.bounds for p in declared])
        wide = typical[:, 1] > _WIDE * typical[:, 0]
        logs = wide & (typical[:, 0] > 0) & (bounds[:, 0] > 0)
        spread = np.ptp(_measured(typical.T, logs), axis=0) / np.sqrt(12)
        low, high = _measured(bounds.T, logs) / spread
        return cls(in_doubles(model), free, logs, spread, low, high)

    def middle(self) -> Float[np.ndarray, " p"]:
        """The middles of the typical ranges."""
        declared = parameters(self.template)
        typical = np.array([declared[name].typical for name in self.free])
        return np.mean(_measured(typical.T, np.asarray(self.logs)), axis=0) / self.spread

    def place(self, model: Model) -> Float[np.ndarray, " p"]:
        """The coordinates of a model's free parameters, which are first moved into the box."""
        values = np.array([value_at(model, name) for name in self.free], np.float64)
        return np.clip(_measured(values, np.asarray(self.logs)) / self.spread, self.low, self.high)

    def model(self, z: Float[Numbers, " p"]) -> Model:
        """The model at the coordinates z."""
        own = z * self.spread
        values = jnp.where(self.logs, jnp.exp(jnp.where(self.logs, own, 0.0)), own)
        return replaced(self.template, self.free, values)

    def slopes(self, z: Float[Numbers, " p"]) -> Float[Array, " p"]:
        """Derivatives of the parameters by z."""
        factors = jnp.exp(jnp.where(self.logs, z * self.spread, 0.0))
        return jnp.asarray(self.spread * factors)

    def gather(self, tree: eqx.Module) -> Array:
        """Stacks the leaves of the free parameters, of a pytree like the model, on the last axis."""
        return gathered(tree, self.free)


def _measured(
    values: Float[np.ndarray, "*k p"], logs: Bool[np.ndarray, " p"]
) -> Float[np.ndarray, "*k p"]:
    """Values, or their logarithms."""
    return np.where(logs, np.log(np.where(logs, np.maximum(values, 1e-300), 1.0)), values)
