"""Draws of a fit's parameters from their posterior."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from petalfit.components import parameters
from petalfit.observations import TargetError
from petalfit.results.trait import traits_of_many
from petalfit.surfaces import AbstractSurface

_DOUBTFUL = 0.7


@dataclasses.dataclass(frozen=True, eq=False)
class Draws:
    """Draws of the free parameters, all equally likely.

    Attributes:
        names: Names of the free parameters of the model, followed by "scale" if that of the pose is free.
        values: A row for each draw, shape (n, p). A scale is in the target's unit.
        k_hat: The diagnostic of Pareto-smoothed importance sampling (Vehtari et al. 2024): up to 0.7 the
            draws follow the likelihood, above they may be far from it. NaN if the draws are Gaussian
            and not compared with the likelihood: with a discrepancy, and for targets other than one
            cloud.
        model: The fitted model, with the values of the parameters that are not free.
        scale: The length of its unit in the target's.
    """

    names: tuple[str, ...]
    values: Float64[np.ndarray, "n p"]
    k_hat: float
    model: AbstractSurface
    scale: float

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, name: str) -> Float[np.ndarray, " n"]:
        """The draws of one parameter."""
        return self.values[:, self.names.index(name)]

    @property
    def believable(self) -> bool:
        """Whether `k_hat` gives no reason to doubt that the draws follow the likelihood."""
        return not self.k_hat > _DOUBTFUL

    def as_dict(self) -> dict[str, Float[np.ndarray, " n"]]:
        """The draws by name of the parameter."""
        return {name: self[name] for name in self.names}

    def traits(self) -> dict[str, Float[np.ndarray, " n"]]:
        """The traits of every draw by name, in the target's unit; see `petalfit.results.trait`."""
        own = [name for name in self.names if name in parameters(self.model)]
        sized = self.names[-1] == "scale" and "scale" not in own
        scales = self["scale"] if sized else np.full(len(self), self.scale)
        columns = [self.names.index(name) for name in own]
        return traits_of_many(self.model, own, self.values[:, columns], scales)

    def to_arviz(self) -> Any:
        """The draws as one chain of ArviZ's `InferenceData`.

        Raises:
            TargetError: ArviZ is not installed.
        """
        try:
            import arviz  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise TargetError("draws become InferenceData with ArviZ: pip install arviz.") from None
        return arviz.from_dict(posterior={name: x[None] for name, x in self.as_dict().items()})
