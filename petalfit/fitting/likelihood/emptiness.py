"""The cost of an outline that encloses empty places.

A stretch dl of the outline whose nearest point is at a distance g costs ρ dl (g − 2/√ρ)³/6τ², where ρ
is the density of the points and τ the blur of the edges: every empty place inside counts like a point at
that distance beyond the edge. Where the outline follows the points, hardly any place of it is that far
from one.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from petalfit.fitting.likelihood.scales import spacing
from petalfit.fitting.likelihood.spans import border_weights

_SLACK = 2.0  # spacings of the points, up to which no place of the outline is empty


@dataclasses.dataclass(frozen=True, eq=False)
class Emptiness:
    """The points of a cloud, as the cost of an outline needs them.

    Attributes:
        tree: The tree of the points.
        spacing: Their typical spacing, 1/√ρ.
        rate: ρ dl of the places on the outline; the outline is taken as that of a square.
    """

    tree: KDTree
    spacing: float
    rate: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]) -> Emptiness:
        """The points that most likely belong to the surface."""
        likely = points[weights > 0.5 * np.max(weights)]
        # It is asked for few places, so that a tree that is quickly made is the faster one.
        tree = KDTree(likely, balanced_tree=False, compact_nodes=False)
        apart = spacing(tree)
        return cls(tree, apart, np.sqrt(np.sum(weights)) * border_weights() / apart)

    def cost(
        self, outline: Float[np.ndarray, "k 3"], moved: Float[np.ndarray, "3 k p"], tau: float
    ) -> tuple[float, Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
        """The cost, its gradient and its information. By log τ it changes by −2 times itself.

        Args:
            outline: Places on the outline.
            moved: Their derivatives by the coordinates.
            tau: The blur of the edges.
        """
        gap, index = self.tree.query(outline)
        away = (outline - self.tree.data[index]) / np.maximum(gap, 1e-300)[:, None]
        excess, rate = np.maximum(gap - _SLACK * self.spacing, 0.0), self.rate / tau**2
        by_z = np.einsum("ki,ikp->kp", away, moved)
        return (
            float(np.sum(rate * excess**3) / 6),
            by_z.T @ (0.5 * rate * excess**2),
            (by_z.T * (rate * excess)) @ by_z,
        )
