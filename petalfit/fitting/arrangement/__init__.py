"""The arrangement of petals about the axis of their flower."""

from petalfit.fitting.arrangement.axis import About as About
from petalfit.fitting.arrangement.axis import Axis as Axis
from petalfit.fitting.arrangement.axis import Placed as Placed
from petalfit.fitting.arrangement.axis import axes_of as axes_of
from petalfit.fitting.arrangement.refinement import refined as refined
from petalfit.fitting.arrangement.refinement import regular_axis as regular_axis
from petalfit.fitting.arrangement.whorls import Arranged as Arranged
from petalfit.fitting.arrangement.whorls import arranged as arranged
