"""The synthetic cases of the repository: small ones, each with one difficulty."""

from __future__ import annotations

import numpy as np

from petalfit.components import PeonyPetal
from petalfit.synthetic.case import Case
from petalfit.synthetic.flower_case import FlowerCase
from petalfit.synthetic.random_petal import random_petal
from petalfit.synthetic.sight import Sight


def _petal(seed: int) -> PeonyPetal:
    return random_petal(np.random.default_rng(seed))


_OBLIQUE = (0.6, -0.8, 1.2)
_MIDDLE = (0.0, 12.0, 0.0)


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
        "anywhere", "in its own unit, but turned and far away", _petal(31), 2000, 0.05, 31,
        turn=(1.4, -0.9, 2.0), shift=(310.0, -45.0, 80.0),
    ),
    Case(
        "clutter", "anywhere, a third of the points clutter, a quadrant not seen", _petal(32), 2000,
        0.05, 32, strays=666, hidden=(0.0, 0.5), turn=(-2.0, 0.7, 0.4), shift=(-12.0, 95.0, 33.0),
    ),
    Case(
        "wrong-unit", "anywhere, and in another unit", _petal(33), 2000, 0.05, 33,
        turn=(0.3, 2.2, -1.0), shift=(4.0, 2.0, -7.0), unit=0.01,
    ),
    Case(
        "gradient", "ten times denser at the base than at the tip", _petal(34), 1500, 0.05, 34,
        thinning=10.0,
    ),
    Case(
        "fine-ribs", "a narrow petal, its ribs at the highest frequency and faint",
        PeonyPetal(
            a_x=10.0, b_y=40.0, c_z=-1.0, c=1.0, dx=-0.15, dy=-5.0, rib_frequency=32.0,
            rib_amplitude=0.15, midrib_height=1.0, tip_curl=3.0,
        ),
        1500, 0.05, 18,
    ),
    Case(
        "mask-front", "shows a_x, b_y and c, and nothing else", _petal(21), 0, 0.0, 21,
        sights=(Sight((0.0, 0.0, 1.0), _MIDDLE, 4.5),),
    ),
    Case(
        "mask-oblique", "one view from which all but the ribs can be told", _petal(22), 0, 0.0, 22,
        sights=(Sight(_OBLIQUE, _MIDDLE, 4.5),),
    ),
    Case(
        "mask-coverage", "the same view with anti-aliased edges", _petal(22), 0, 0.0, 22,
        sights=(Sight(_OBLIQUE, _MIDDLE, 4.5, kind="coverage"),),
    ),
    Case(
        "mask-ribs", "an arched petal from its tip: ribs shape the outline",
        PeonyPetal(
            a_x=15.0, b_y=36.0, c_z=0.2, c=0.5, dx=0.3, dy=4.5, rib_frequency=17.0,
            rib_amplitude=0.45, midrib_height=1.5, tip_curl=0.5,
        ),
        0, 0.0, 23, sights=(Sight((0.0, 1.0, 0.05), (0.0, 12.0, 0.0), 8.0),),
    ),
    Case(
        "masks-three", "three views of one petal", _petal(24), 0, 0.0, 24,
        sights=(
            Sight(_OBLIQUE, _MIDDLE, 4.0),
            Sight((-1.0, 0.2, 0.8), _MIDDLE, 4.0),
            Sight((0.0, 0.0, 1.0), _MIDDLE, 4.0),
        ),
    ),
    Case(
        "joint", "half a cloud, and one mask", _petal(15), 750, 0.05, 15,
        keep=((1.0, 0.0, 0.0), 0.0), sights=(Sight(_OBLIQUE, _MIDDLE, 3.6),),
    ),
    Case(
        "mask-cropped", "the tip lies outside of the image", _petal(25), 0, 0.0, 25,
        sights=(Sight(_OBLIQUE, (0.0, 4.0, 0.0), 6.5),),
    ),
    Case(
        "mask-noisy", "an edge cut out by hand, off by one pixel", _petal(26), 0, 0.0, 26,
        sights=(Sight(_OBLIQUE, _MIDDLE, 4.5, edge=1.0),),
    ),
)  # fmt: skip

_ABOVE = 0.7
# Directions all around: below, beside and above the horizon, and straight from above.
_ALL_AROUND = (
    *((1.0, y, 0.0) for y in (-0.5, 0.1, _ABOVE)),
    *((-0.5, y, z) for y in (-0.5, 0.1, _ABOVE) for z in (-0.87, 0.87)),
    *((-1.0, y, 0.0) for y in (-0.5, 0.1, _ABOVE)),
    *((0.5, y, z) for y in (-0.5, 0.1, _ABOVE) for z in (-0.87, 0.87)),
    (0.0, 1.0, 0.0),
)
_THREE = ((1.0, _ABOVE, 0.0), (-0.5, _ABOVE, 0.87), (-0.5, _ABOVE, -0.87))

FLOWERS: tuple[FlowerCase, ...] = (
    FlowerCase(
        "flower-lily", "a lily with stamens, pistil and stalk, from all around",
        "lily", 12_000, 0.06, 0, _ALL_AROUND, turn=(0.4, 1.1, -0.3),
    ),
    FlowerCase(
        "flower-lily-table", "a lily on a table, seen from three sides",
        "lily", 10_000, 0.06, 1, _THREE, table=True, turn=(-1.2, 0.2, 0.7),
    ),
    FlowerCase(
        "flower-lily-side", "a lily seen from one side: half of it is hidden",
        "lily", 6000, 0.06, 2, _THREE[:1], turn=(0.9, -0.5, 2.0),
    ),
    FlowerCase(
        "flower-peony", "fifteen petals along a spiral around ninety stamens, from all around",
        "small peony", 12_000, 0.05, 0, _ALL_AROUND, turn=(0.2, 0.3, -1.1),
    ),
)  # fmt: skip
