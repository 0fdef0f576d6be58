"""Petals with random parameters."""

from __future__ import annotations

import numpy as np

from petalfit.components import PeonyPetal

# The ranges, in the order in which parameters are drawn. c_z and midrib_sharpness stay near the paper's
# values: the first is an offset, the second is not fitted.
RANGES: dict[str, tuple[float, float]] = {
    "a_x": (10.0, 24.0),
    "b_y": (16.0, 40.0),
    "c_z": (-1.0, 1.0),
    "c": (0.2, 1.0),
    "dx": (0.15, 0.7),  # of either sign
    "dy": (-5.0, 5.0),
    "rib_frequency": (8.0, 32.0),
    "rib_amplitude": (0.15, 0.5),
    "midrib_height": (1.0, 4.0),
    "tip_curl": (-3.0, 3.0),
}
_DECIMALS = 4


def random_petal(rng: np.random.Generator) -> PeonyPetal:
    """A peony petal with parameters drawn uniformly from `RANGES`.

    Args:
        rng: The random generator; the same state gives the same petal.

    Returns:
        A petal whose parameters have four decimals, so that printing them loses nothing.
    """
    values = {name: rng.uniform(low, high) for name, (low, high) in RANGES.items()}
    values["dx"] *= rng.choice([-1.0, 1.0])
    return PeonyPetal(**{name: round(float(value), _DECIMALS) for name, value in values.items()})
