"""The parts of a report that depend on the kind of observation."""

from petalfit.report.shown.protocol import AbstractShown as AbstractShown
from petalfit.report.shown.registry import in_scene as in_scene
from petalfit.report.shown.registry import shown as shown
