"""The lily of the paper's section 3.2: one pistil, six stamens, six petals."""

from __future__ import annotations

import numpy as np

from petalfit.colours import Colour, RadialPattern, RibPattern
from petalfit.components import (
    Anther,
    CylinderReceptacle,
    Filament,
    Ovary,
    Pedicel,
    PeonyPetal,
    Pistil,
    Stamen,
    Stigma,
    Style,
)
from petalfit.flowers.flower import Flower, Series
from petalfit.flowers.gynoecium import pistils
from petalfit.flowers.phyllotaxis import whorls

# White, with a green throat, and a blush along the midrib.
_TEPAL = Colour.of(
    "#fbf4ee",
    "#e58fae",
    "#a8c66c",
    patterns=(
        RibPattern(i_1=0.0, i_2=2.2, f=1.0, n_1=0.6, n_2=0.3, k=3.0),
        RadialPattern(i_1=0.0, i_2=1.0, n=6.0, f=0.5, phi=np.pi / 2),
    ),
)


def lily(seed: int = 0) -> Flower:
    """A lily: two whorls of three tepals, six stamens with versatile anthers, a pistil of one style.

    Args:
        seed: The seed of the small differences between organs.
    """
    rng = np.random.default_rng(seed)
    tepals, stamens = whorls(3, 3), whorls(3, 3)

    def about(value: float, spread: float) -> float:
        return value * (1 + spread * float(rng.uniform(-1, 1)))

    return Flower(
        name="lily",
        receptacle=CylinderReceptacle(r=1.7, h=3.0),
        pedicel=Pedicel(r=1.1, h=40.0, a_1=0.35, a_2=2.5),
        series=(
            Series.of(
                "petal",
                [
                    PeonyPetal(
                        a_x=about(7.5 + 2.5 * rank, 0.03),
                        b_y=about(40.0, 0.03),
                        c=-1.9,
                        dx=-0.25,
                        dy=about(-9.0, 0.1),
                        rib_amplitude=0.12,
                        rib_frequency=9.0,
                        midrib_height=-0.8,
                        tip_curl=-2.0,
                    )
                    for rank in tepals.rank
                ],
                tepals,
                _TEPAL,
                latitude=0.25 + 0.2 * tepals.rank,
                opening=np.array([about(0.45, 0.08) for _ in tepals.rank]),
            ),
            Series.of(
                "stamen",
                [
                    Stamen(
                        Filament(r=0.45, h=about(34.0, 0.04), a_2=about(-5.0, 0.2)),
                        Anther(r=0.9, swell=0.5),
                        tilt=about(1.2, 0.2),
                    )
                    for _ in stamens.rank
                ],
                stamens,
                {"filament": Colour.of("#dfe8c0"), "anther": Colour.of("#9c4a1e")},
                latitude=0.9,
                opening=0.16,
            ),
            pistils(
                "simple",
                pistil=Pistil(
                    Ovary(r=1.6),
                    Style(r=0.55, swell=0.1, bend=0.6, slenderness=58.0),
                    Stigma(r=1.5, h=0.9),
                ),
                colours={
                    "ovary": Colour.of("#8fae5a"),
                    "style": Colour.of("#dfe8c0"),
                    "stigma": Colour.of("#7a4a63"),
                },
            ),
        ),
        colours={"receptacle": Colour.of("#8fae5a"), "pedicel": Colour.of("#5f8a3c")},
    )
