"""The suites, in the order in which they run."""

from __future__ import annotations

import importlib

from benchmarks.metric import Suite

NAMES = (
    "startup",
    "recovery",
    "silhouette",
    "robustness",
    "real",
    "area",
    "speed",
    "scaling",
    "studio",
)
# These measure no time that is compared: a quick run lets two of them run at once.
UNTIMED = ("recovery", "silhouette", "robustness", "real", "area")


def suite(name: str) -> Suite:
    """By its name; imported when it runs, in a process of its own."""
    return importlib.import_module(f"benchmarks.suites.{name}").run
