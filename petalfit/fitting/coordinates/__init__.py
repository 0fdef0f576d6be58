"""The coordinates in which a fit works, and priors on them."""

from petalfit.fitting.coordinates.box import Box as Box
from petalfit.fitting.coordinates.coordinates import Coordinates as Coordinates
from petalfit.fitting.coordinates.coordinates import Model as Model
from petalfit.fitting.coordinates.coordinates import Numbers as Numbers
from petalfit.fitting.coordinates.coordinates import evenly_spread as evenly_spread
from petalfit.fitting.coordinates.coordinates import with_values as with_values
from petalfit.fitting.coordinates.prior import Prior as Prior
