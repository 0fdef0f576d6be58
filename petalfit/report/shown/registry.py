"""The registry of the kinds of observation that a report can show."""

from __future__ import annotations

from petalfit.report.shown.cloud import ShownCloud
from petalfit.report.shown.mask import ShownMask
from petalfit.report.shown.protocol import AbstractShown
from petalfit.results import Agreement, FitRecord

# One line for each kind.
SHOWN: dict[str, AbstractShown] = {
    "cloud": ShownCloud(),
    "mask": ShownMask(),
}


def shown(part: Agreement) -> AbstractShown:
    """The presentation of an observation, by its kind.

    Raises:
        TypeError: A report cannot show this kind.
    """
    kind = part.target.kind
    if kind not in SHOWN:
        raise TypeError(
            f"a report cannot show a {kind!r}, only {', '.join(map(repr, SHOWN))}; register how it is "
            "shown in petalfit.report.shown.registry."
        )
    return SHOWN[kind]


def in_scene(result: FitRecord) -> list[Agreement]:
    """The observations of a fit whose points are drawn in space with the surface."""
    return [part for part in result.agreements if shown(part).in_scene]
