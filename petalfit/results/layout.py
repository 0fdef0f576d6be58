"""The layout of a flower: how its petals are arranged about its axis, as far as they show it."""

from __future__ import annotations

import dataclasses
import math

from petalfit.results.meaning import WithMeaning


class LayoutKind(WithMeaning):
    """The kind of an arrangement. Each member is the string that files hold.

    Attributes:
        meaning: The explanation of the kind, in one sentence.
    """

    WHORLS = "whorls", "Petals stand at equal angles in one ring or several."
    SPIRAL = "spiral", "Every petal is turned from the one outside it by the same angle."
    NOT_DETERMINED = "not determined", "The petals show no regular arrangement."


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A number with its standard error, which is infinite where the number is not determined.

    Attributes:
        value: The number.
        stderr: Its standard error.
    """

    value: float
    stderr: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ± {self.stderr:.2g}" if self.determined else "not determined"

    @property
    def determined(self) -> bool:
        """Whether the petals determine the number."""
        return math.isfinite(self.stderr)


@dataclasses.dataclass(frozen=True)
class Whorl:
    """A ring of petals at equal angles about the flower's axis.

    Attributes:
        petals: The numbers of its petals in the result.
        phase: The azimuth of the first of them, in rad, from the flower's x axis towards its z axis.
        opening: The angle between the flower's axis and the petals, in rad.
        height: The height of their bases along the axis, in the target's unit.
    """

    petals: tuple[int, ...]
    phase: Quantity
    opening: Quantity
    height: Quantity

    @property
    def count(self) -> int:
        """The number of petals."""
        return len(self.petals)


@dataclasses.dataclass(frozen=True)
class Layout:
    """How the petals of a flower are arranged.

    Attributes:
        kind: Whorls, a spiral, or neither.
        whorls: The whorls, the outermost first; empty for another kind.
        divergence: The angle from a petal of a spiral to the next one inwards, or from a whorl to the
            next one, in rad.
        axis_stderr: Standard error of the direction of the flower's axis, in rad.
    """

    kind: LayoutKind
    whorls: tuple[Whorl, ...]
    divergence: Quantity
    axis_stderr: float

    @property
    def described(self) -> str:
        """The layout in a few words."""
        if self.kind is LayoutKind.WHORLS:
            return f"whorls of {' + '.join(str(whorl.count) for whorl in self.whorls)}"
        if self.kind is LayoutKind.SPIRAL:
            degrees = [math.degrees(x) for x in (self.divergence.value, self.divergence.stderr)]
            return f"spiral with a divergence of {degrees[0]:.1f}° ± {degrees[1]:.1f}°"
        return "no regular arrangement"
