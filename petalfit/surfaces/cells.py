"""A division of a domain into equal cells, in which places of a surface are counted."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from petalfit.surfaces.map import Domain


def cells(
    domain: Domain, uv: Float[np.ndarray, "n 2"], side: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """The numbers of the cells that places lie in.

    Args:
        domain: The ranges of u and v, which are divided into side × side equal cells.
        uv: The places, shape (n, 2).
        side: The number of cells along u, and along v.

    Returns:
        The number along u and the number along v of each place's cell, each of shape (n,).
    """
    low, high = np.array(domain).T
    across, along = np.clip((side * (uv - low) / (high - low)).astype(int), 0, side - 1).T
    return across, along
