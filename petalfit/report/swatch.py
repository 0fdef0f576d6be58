"""Coloured dots in a text, and the legend of grey points."""

from __future__ import annotations

from petalfit.report.colour import IGNORED, css
from petalfit.report.scene import Scene


def swatch(colour: str) -> str:
    """A dot as HTML, of a colour or of any other CSS background."""
    return f'<span class="swatch" style="background:{colour}"></span>'


def ignored(scene: Scene) -> str:
    """A phrase that explains grey points, if there are any."""
    if scene.used.all():
        return ""
    return f" ({swatch(css(IGNORED))} without weight or taken for strays)"
