"""The likelihood of empty places: a surface that was scanned has points near all of its places."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.observed import (
    AbstractObserved,
    Residuals,
    ScoreAndInformation,
)
from petalfit.fitting.likelihood.quadrature import Quadrature
from petalfit.observations import TargetError
from petalfit.residuals import AbstractTerm, Emptiness
from petalfit.surfaces import AbstractSurface

_SLACK = 1.5  # spacings of the points
_FEWEST = 7  # points whose spacing can be told


def spacing(tree: KDTree) -> float:
    """The typical spacing of points on a surface: the side of the square that one point covers."""
    # The disc that reaches to the sixth neighbour has the area of six and a half points.
    sixth = np.median(np.asarray(tree.query(tree.data, 7)[0])[:, 6])
    return float(sixth * np.sqrt(np.pi / 6.5))


@dataclasses.dataclass(frozen=True)
class ObservedEmptiness(AbstractObserved):
    """The cost of places of the surface that have no points near them.

    Attributes:
        tree: The tree of the points.
        slack: The distance from the nearest point up to which a place costs nothing.
    """

    tree: KDTree
    slack: float

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"]) -> ObservedEmptiness:
        if len(points) < _FEWEST:
            raise TargetError(
                f"only {len(points)} of the points seem to belong to one surface, and all others look like "
                "clutter; if they are none, use loss='linear', else crop the cloud to the petal."
            )
        tree = KDTree(points)
        return cls(tree, _SLACK * spacing(tree))

    def match(self, model: AbstractSurface, term: AbstractTerm | None) -> Emptiness:
        return self.around(model)[0]

    def around(self, model: AbstractSurface) -> tuple[Emptiness, Quadrature, float]:
        """The term, the nodes on the surface that it is made of, and twice its cost for a noise of 1."""
        nodes = Quadrature.of(model)
        gap, nearest = map(np.asarray, self.tree.query(nodes.places))
        weights = self.tree.n * nodes.area.ravel() / nodes.area.sum()
        term = Emptiness(
            uv=jnp.asarray(nodes.uv),
            nearest=jnp.asarray(self.tree.data[nearest]),
            weights=jnp.asarray(weights),
            slack=jnp.asarray(self.slack),
            sigma=jnp.asarray(self.slack),
        )
        return term, nodes, float(np.sum(weights * np.maximum(gap - self.slack, 0.0) ** 2))

    def misfit(self, model: AbstractSurface) -> float:
        return 0.0

    def information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> tuple[np.ndarray, float]:
        return np.zeros((len(t), len(t))), float(term.sigma)

    def score_and_information(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> ScoreAndInformation:
        nothing = np.zeros((len(t), len(t)))
        return ScoreAndInformation(term, nothing, np.zeros(len(t)), nothing)

    def residuals(
        self, coordinates: Coordinates, t: np.ndarray, term: AbstractTerm
    ) -> list[Residuals]:
        return []
