"""Dots of a colour in a text, and what they stand for."""

from __future__ import annotations

from petalfit.report.colour import IGNORED, css
from petalfit.report.scene import Scene


def swatch(colour: str) -> str:
    """A dot of a colour, or of any background that CSS knows."""
    return f'<span class="swatch" style="background:{colour}"></span>'


def ignored(scene: Scene) -> str:
    """What grey points are, if there are any."""
    if scene.used.all():
        return ""
    return f" ({swatch(css(IGNORED))} without weight or taken for strays)"
