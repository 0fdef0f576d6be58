"""Traits that a component declares, so that a fit need not know its class."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Oscillation:
    """A pattern of many waves, ribs for instance, that may be absent.

    The cost of a fit has many minima along its frequency, and without an amplitude it has none: a fit
    compares several frequencies, and calls the frequency determined only if the amplitude is.

    Attributes:
        frequency: Name of the parameter that counts the waves.
        amplitude: Name of the parameter that says how high they are.
    """

    frequency: str
    amplitude: str

    @property
    def names(self) -> tuple[str, str]:
        """The frequency and the amplitude."""
        return self.frequency, self.amplitude
