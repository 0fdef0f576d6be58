"""The gynoecium, Fig. 5: one simple pistil, several separate ones, or one of joined carpels."""

from __future__ import annotations

import math

from petalfit.colours import Colour
from petalfit.components import CompoundPistil, Pistil
from petalfit.flowers.flower import Series
from petalfit.flowers.phyllotaxis import whorls

KINDS = ("simple", "apocarpous", "compound")


def pistils(
    kind: str,
    carpels: int = 1,
    pistil: Pistil | None = None,
    colours: dict[str, Colour] | None = None,
) -> Series:
    """Pistils of one of three kinds, on top of the receptacle.

    - simple: one pistil of one carpel;
    - apocarpous: as many separate pistils as carpels, each turned and leaning outwards (Fig. 5(a));
    - compound: one pistil of joined carpels (Fig. 5(b) and (c)).

    Args:
        kind: The name of the kind.
        carpels: The number of carpels; 1 for a simple pistil, at least 2 for the others.
        pistil: The pistil that every carpel is a copy of.
        colours: The colours of the parts, "ovary", "style" and "stigma".

    Raises:
        ValueError: The kind is none of these, or does not occur with that number of carpels.
    """
    if kind not in KINDS:
        raise ValueError(f"pistils are {', '.join(KINDS)}; received {kind!r}")
    if (carpels == 1) != (kind == "simple") or carpels < 1:
        least = "exactly 1 carpel" if kind == "simple" else "2 carpels or more"
        raise ValueError(f"{kind} pistils have {least}; received {carpels}")
    carpel = pistil or Pistil()
    paint = colours or {
        "ovary": Colour.of("#7fa650"),
        "style": Colour.of("#a9c27a"),
        "stigma": Colour.of("#8c5a3c"),
    }
    match kind:
        case "simple":
            return Series.of("pistil", carpel, whorls(1), paint)
        case "compound":
            return Series.of("pistil", CompoundPistil(carpel, carpels=carpels), whorls(1), paint)
        case _:
            # At this radius the ovaries of neighbours just touch.
            apart = 1.05 * float(carpel.ovary.r) / math.sin(math.pi / carpels)
            return Series.of("pistil", carpel, whorls(carpels), paint, radius=apart, opening=0.15)
