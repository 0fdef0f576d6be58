"""How a report shows each kind of observation beside the fit."""

from petalfit.report.shown.protocol import AbstractShown as AbstractShown
from petalfit.report.shown.registry import in_scene as in_scene
from petalfit.report.shown.registry import shown as shown
