"""Colours over (u, v): the paper's patterns (Eqs. 9 and 10) and the palettes that they mix."""

from petalfit.colours.colour import Colour as Colour
from petalfit.colours.pattern import AbstractPattern as AbstractPattern
from petalfit.colours.pattern import RadialPattern as RadialPattern
from petalfit.colours.pattern import RibPattern as RibPattern
from petalfit.colours.srgb import from_hex as from_hex
from petalfit.colours.srgb import to_hex as to_hex
from petalfit.colours.srgb import to_linear as to_linear
from petalfit.colours.srgb import to_srgb as to_srgb
