"""The system's Chromium, without a window and drawing in software, for benchmarks and for tests."""

from __future__ import annotations

import shutil

_NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


def program() -> str | None:
    """Its path; None if there is none on PATH. Nothing is downloaded."""
    return next(filter(None, map(shutil.which, _NAMES)), None)
