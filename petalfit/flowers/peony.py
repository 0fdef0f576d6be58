"""The peony of Figs. 8 and 9: many petals that change from outside to inside, many stamens."""

from __future__ import annotations

import numpy as np

from petalfit.colours import Colour, RadialPattern, RibPattern
from petalfit.components import (
    Anther,
    Bowl,
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
from petalfit.flowers.phyllotaxis import recursion, scattered

# Rose, deeper at the base and along the veins.
_PETAL = Colour.of(
    "#f3b3c8",
    "#d9437e",
    "#b8215f",
    patterns=(
        RibPattern(i_1=0.0, i_2=0.35, f=21.0, n_1=0.4, n_2=0.5, k=0.5),
        RadialPattern(i_1=0.0, i_2=0.8, n=5.0, f=0.5, phi=np.pi / 2),
    ),
)


def peony(seed: int = 0, petals: int = 48) -> Flower:
    """A peony: petals by the paper's recursion, 90 stamens at random places, five pistils.

    "The inside petals are bigger and more bender than outside petals" (3.2): width, length and bend grow
    with the rank.

    Args:
        seed: The seed of the places of the stamens and of the small differences between organs.
        petals: The number of petals.
    """
    rng = np.random.default_rng(seed)
    places, stamens = recursion(petals, growth=0.985), scattered(90, seed)

    def about(value: float, spread: float) -> float:
        return value * (1 + spread * float(rng.uniform(-1, 1)))

    return Flower(
        name="peony",
        receptacle=Bowl(r=2.4),
        pedicel=Pedicel(r=2.0, h=45.0, a_1=0.5, a_2=3.0),
        series=(
            Series.of(
                "petal",
                [
                    PeonyPetal(
                        a_x=about(13.0 + 2.0 * rank, 0.06),
                        b_y=about(14.0 + 4.0 * rank, 0.06),
                        c=0.6,
                        dx=about(0.35, 0.3),
                        dy=about(2.0 + 3.0 * rank, 0.2),
                        rib_frequency=about(18.0, 0.1),
                        rib_amplitude=about(0.35, 0.3),
                        midrib_height=0.6,
                        tip_curl=about(1.5, 0.4),
                    )
                    for rank in places.rank
                ],
                places,
                _PETAL,
                latitude=-0.3 + 0.3 * places.rank,
                opening=np.array([about(1.3 - 0.6 * rank, 0.07) for rank in places.rank]),
                roll=rng.uniform(-0.12, 0.12, len(places)),
            ),
            Series.of(
                "stamen",
                [
                    Stamen(
                        Filament(r=0.22, h=about(13.0, 0.15), a_2=about(-1.2, 0.8)),
                        Anther(r=0.42, swell=0.3),
                        tilt=about(0.3, 1.0),
                    )
                    for _ in stamens.rank
                ],
                stamens,
                {"filament": Colour.of("#f0e3b2"), "anther": Colour.of("#e8a91e")},
                latitude=0.5 + 0.6 * stamens.rank,
                opening=0.45 - 0.3 * stamens.rank,
            ),
            pistils(
                "apocarpous",
                5,
                Pistil(Ovary(r=0.75), Style(r=0.28, swell=0.05, bend=0.2), Stigma(r=0.5, h=0.35)),
                {
                    "ovary": Colour.of("#9db560"),
                    "style": Colour.of("#c9d39a"),
                    "stigma": Colour.of("#d0587f"),
                },
            ),
        ),
        colours={"receptacle": Colour.of("#7f9a4a"), "pedicel": Colour.of("#55803a")},
    )
