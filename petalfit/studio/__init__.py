"""Fits in the browser: files in, a petal that settles while one looks on, sliders, files out."""

from petalfit.studio.server import Studio as Studio
