"""The margin of a fitted sheet, and how far outside of its points it must lie.

Points of a finite sample lie inside the margin that they were drawn from, and a surface that just
encloses them is too small. Efron (1965) showed by how much, for convex hulls: the part of the area that
is missing is, on average, the part of the points that hold the hull. The same holds for every surface
whose edges are held by points beyond them, because a point that is left out lies beyond the new edges
exactly if it had held the old ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.stats import norm

from petalfit.residuals import frames
from petalfit.surfaces import AbstractSurface

_NODES = 33  # nodes on each side
# Width, in spacings of the points, of the strip along the edge in which points are counted.
_STRIP = 0.3
# So many times as many points there as elsewhere were put on the margin, such as the vertices of a mesh.
_CROWDED = 2.0


class Margin(NamedTuple):
    """The four sides of a surface, as nodes.

    Attributes:
        uv: Where the nodes are, shape (k, 2).
        outward: Unit vectors within the surface that are normal to the margin, shape (k, 3).
        length: The length of the margin that each node stands for, shape (k,).
    """

    uv: Float[np.ndarray, "k 2"]
    outward: Float[np.ndarray, "k 3"]
    length: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, surface: AbstractSurface) -> Margin:
        (u_low, u_high), (v_low, v_high) = surface.domain
        u, v = np.linspace(u_low, u_high, _NODES), np.linspace(v_low, v_high, _NODES)
        # (u, v) along each side, and which of the two edges at a foot point it is.
        sides = [(np.full(_NODES, x), v, 0) for x in (u_low, u_high)]
        sides += [(u, np.full(_NODES, x), 1) for x in (v_low, v_high)]
        uv, outward, length = [], [], []
        for across, along, edge in sides:
            place = np.stack([across, along], axis=-1)
            here = frames(surface, place)
            steps = np.linalg.norm(np.gradient(here.position, axis=0), axis=-1)
            steps[[0, -1]] *= 0.5
            uv.append(place)
            outward.append(here.conormals[:, edge])
            length.append(steps)
        return cls(np.concatenate(uv), np.concatenate(outward), np.concatenate(length))


def gap(
    beyond: Float[np.ndarray, " n"], noise: float, spacing: float, perimeter: float
) -> tuple[float, float]:
    """How far outside of a surface's edges the margin lies, and how many points hold the edges.

    Args:
        beyond: Distances of points beyond the edges, negative inside.
        noise: Their noise.
        spacing: The side of the square that one point covers.
        perimeter: The length of the margin.
    """
    holding = float(np.count_nonzero(beyond > 0))
    expected = _STRIP * perimeter / spacing
    crowd = np.count_nonzero(beyond > -_STRIP * spacing)
    if crowd > _CROWDED * expected:
        return 0.0, holding
    missing = holding * spacing**2 / perimeter
    # With noise, points lie beyond an edge that is in the right place already.
    ratio = missing / max(noise, 1e-12 * spacing)

    def too_many(z: float) -> float:
        return float(norm.pdf(z) + z * norm.cdf(z)) - ratio

    z = brentq(too_many, -8.0, ratio + 1.0)
    return noise * float(z), holding  # pyright: ignore[reportArgumentType]
