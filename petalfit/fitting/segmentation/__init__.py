"""Segmentation of a cloud of several sheets: which points lie on the same one."""

from petalfit.fitting.segmentation.meeting import meeting_point as meeting_point
from petalfit.fitting.segmentation.segments import Segments as Segments
from petalfit.fitting.segmentation.segments import segments_of as segments_of
from petalfit.fitting.segmentation.sheets import FEWEST as FEWEST
from petalfit.fitting.segmentation.sheets import Sheets as Sheets
from petalfit.fitting.segmentation.sheets import sheets_of as sheets_of
