"""Arrangements of organs around the axis (3.2): whorls, the paper's recursion, L-systems, random places.

An arrangement gives two numbers for each organ: its azimuth, and its rank, from 0 for the outermost to 1
for the innermost. Everything else that changes from outside to inside is a function of the rank.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))  # 137.5°
# A longer word is taken for a mistake: words grow exponentially with the number of generations.
_LONGEST_WORD = 1_000_000


class Arrangement(NamedTuple):
    """The places of k organs around the axis.

    Attributes:
        azimuth: The angles about the flower's axis, in rad, from x towards z; shape (k,).
        rank: The ranks, from 0 outside to 1 inside; shape (k,).
    """

    azimuth: Float[np.ndarray, " k"]
    rank: Float[np.ndarray, " k"]

    def __len__(self) -> int:
        return len(self.azimuth)


def whorls(*counts: int) -> Arrangement:
    """Whorls of organs at equal angles, the outermost first; each whorl fills the gaps of the last one.

    Args:
        counts: The number of organs of each whorl, at least 1; `whorls(3, 3)` for the tepals of a lily.

    Raises:
        ValueError: A count is less than 1, or no count is given.
    """
    _require_counts(*counts)
    azimuths, turn = [], 0.0
    for count in counts:
        azimuths.append(turn + 2 * math.pi * np.arange(count) / count)
        turn += math.pi / count
    rank = np.arange(len(counts)) / max(len(counts) - 1, 1)
    return Arrangement(np.concatenate(azimuths), np.repeat(rank, counts))


def recursion(count: int, divergence: float = GOLDEN_ANGLE, growth: float = 1.0) -> Arrangement:
    """The paper's recursion: each organ is turned by an angle and one step further in than the last one.

    Args:
        count: The number of organs, at least 1.
        divergence: The angle between an organ and the next one, in rad. The default, the golden angle,
            gives the spiral of most flowers, in which no two organs are ever in line.
        growth: The ratio of each step inwards to the previous one: 1 for equal steps, less than 1 to
            crowd organs inside.

    Raises:
        ValueError: The count is less than 1, or the growth not positive.
    """
    _require_counts(count)
    if not growth > 0:
        raise ValueError(f"growth must be positive; received {growth}")

    with np.errstate(over="ignore"):
        depth = np.concatenate([[0.0], np.cumsum(growth ** np.arange(count - 1.0))])
    if not np.isfinite(depth[-1]):
        raise ValueError(
            f"growth {growth} over {count} organs has no end; give a growth nearer to 1"
        )
    return Arrangement(divergence * np.arange(count), depth / max(depth[-1], 1e-300))


def scattered(count: int, seed: int) -> Arrangement:
    """Random places: "the position of stamens and petals are determined by random number" (3.2).

    Places are uniform over the disc within the outermost organ and kept apart: each organ takes, of ten
    random places, the one farthest from all earlier organs.

    Args:
        count: The number of organs, at least 1.
        seed: The random seed; the same seed gives the same places.

    Raises:
        ValueError: The count is less than 1.
    """
    _require_counts(count)
    rng = np.random.default_rng(seed)
    places = np.zeros((count, 2))
    for k in range(count):
        radius, angle = np.sqrt(rng.random(10)), 2 * math.pi * rng.random(10)
        trial = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        gaps = np.linalg.norm(trial[:, None] - places[:k], axis=-1)
        places[k] = trial[np.argmax(np.min(gaps, axis=-1, initial=2.0))]
    order = np.argsort(-np.linalg.norm(places, axis=-1), kind="stable")
    x, z = places[order].T
    return Arrangement(np.arctan2(z, x), 1 - np.hypot(x, z))


def rewrite(axiom: str, rules: Mapping[str, str], generations: int) -> str:
    """The word of an L-system: in each generation, rules replace all symbols (Lindenmayer 1968).

    Raises:
        ValueError: `generations` is negative, or the word has more than a million symbols.
    """
    if generations < 0:
        raise ValueError(f"generations must be 0 or more; received {generations}")
    word = axiom
    for _ in range(generations):
        length = sum(n * len(rules.get(s, s)) for s, n in Counter(word).items())
        if length > _LONGEST_WORD:
            raise ValueError(
                f"the L-system's word would have {length} symbols; give fewer generations"
            )
        word = "".join(rules.get(symbol, symbol) for symbol in word)
    return word


def l_system(
    axiom: str, rules: Mapping[str, str], generations: int, angle: float = GOLDEN_ANGLE
) -> Arrangement:
    """The places around the axis that a turtle visits as it follows the word of an L-system.

    `O` puts an organ at the turtle's place; `+` and `-` turn the turtle about the axis by `angle`; `^`
    moves it one step inwards and `v` one step outwards; `[` saves its place and `]` returns to the saved
    place. Other symbols do nothing. Whorls of three, each turned against the last one, are
    `l_system("A", {"A": "[O][++O][++++O]+^A"}, n, π/3)`.

    Args:
        axiom: The word of generation 0.
        rules: The replacement of each symbol in the next generation; symbols without a rule stay.
        generations: The number of generations.
        angle: The angle of one turn, in rad.

    Raises:
        ValueError: The word is too long, puts no organ, or returns to a place that it has not saved.
    """
    turn, depth, kept, places = 0.0, 0.0, [], []
    for symbol in rewrite(axiom, rules, generations):
        match symbol:
            case "O":
                places.append((turn, depth))
            case "+" | "-":
                turn += angle if symbol == "+" else -angle
            case "^" | "v":
                depth += 1.0 if symbol == "^" else -1.0
            case "[":
                kept.append((turn, depth))
            case "]":
                if not kept:
                    raise ValueError(
                        f"the L-system's word has a ] without its [; its axiom is {axiom!r}"
                    )
                turn, depth = kept.pop()
    if not places:
        raise ValueError(f"the L-system's word puts no organ (O); its axiom is {axiom!r}")
    azimuth, depth = np.array(places).T
    return Arrangement(azimuth, (depth - depth.min()) / max(float(np.ptp(depth)), 1.0))


def _require_counts(*counts: int) -> None:
    if not counts or min(counts) < 1:
        raise ValueError(
            f"there must be 1 organ or more; received {', '.join(map(str, counts)) or 0}"
        )
