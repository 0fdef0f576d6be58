"""The arrangement of petals about the axis of their flower."""

from petalfit.fitting.arrangement.axis import Placed as Placed
from petalfit.fitting.arrangement.axis import axis_of as axis_of
from petalfit.fitting.arrangement.axis import meeting_point as meeting_point
from petalfit.fitting.arrangement.whorls import arranged as arranged
