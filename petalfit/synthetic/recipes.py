"""The cases that are committed: small, and each with one difficulty."""

from __future__ import annotations

import numpy as np

from petalfit.components import PeonyPetal
from petalfit.synthetic.case import Case
from petalfit.synthetic.random_petal import random_petal


def _petal(seed: int) -> PeonyPetal:
    return random_petal(np.random.default_rng(seed))


RECIPES: tuple[Case, ...] = (
    Case("clean", "no noise but rounding to 1e-6", _petal(11), 1500, 0.0, 11),
    Case("noisy", "what the others are compared with", _petal(12), 1500, 0.05, 12),
    Case("few", "six points a parameter", _petal(13), 60, 0.02, 13, suffix=".csv"),
    Case("dense", "many points, in single precision", _petal(14), 20_000, 0.05, 14, suffix=".npz"),
    Case(
        "half", "the half with x < 0 was not seen", _petal(15), 1500, 0.05, 15,
        keep=((1.0, 0.0, 0.0), 0.0),
    ),
    Case(
        "no-tip", "everything beyond y = 25 was not seen", _petal(16), 1500, 0.05, 16,
        keep=((0.0, -1.0, 0.0), -25.0),
    ),
    Case("outliers", "2 % of the points are anywhere", _petal(17), 1500, 0.05, 17, strays=30),
    Case(
        "fine-ribs", "a narrow petal, its ribs at the highest frequency and faint",
        PeonyPetal(
            a_x=10.0, b_y=40.0, c_z=-1.0, c=1.0, dx=-0.15, dy=-5.0, rib_frequency=32.0,
            rib_amplitude=0.15, midrib_height=1.0, tip_curl=3.0,
        ),
        1500, 0.05, 18,
    ),
)  # fmt: skip
