"""The studio, for fits in the browser: uploads, a live view of the fit, sliders and downloads."""

from petalfit.studio.server import Studio as Studio
