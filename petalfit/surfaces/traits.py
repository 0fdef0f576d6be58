"""Traits that a component declares, so that fits do not depend on its class."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Oscillation:
    """A pattern of many waves, such as ribs, which may be absent.

    The cost of a fit has many minima along the frequency, and none if the amplitude is zero. A fit
    therefore compares several frequencies, and calls the frequency determined only if the amplitude is.

    Attributes:
        frequency: The name of the parameter for the number of waves.
        amplitude: The name of the parameter for the height of the waves.
    """

    frequency: str
    amplitude: str

    @property
    def names(self) -> tuple[str, str]:
        """The names of the two parameters, the frequency's first."""
        return self.frequency, self.amplitude
