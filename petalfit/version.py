"""The version of petalfit, which files and reports name."""

VERSION = "0.1.0"
