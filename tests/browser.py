"""A browser for tests of what people look at: Chromium without a window, drawing in software."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from benchmarks.chromium import OPTIONS, program

# Milliseconds after which something hangs, and is not merely slow on a busy machine.
A_WHILE = 1_800_000

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Page


# For a module and no longer: while it is open, asyncio takes the main thread for a running loop.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The Chromium on PATH; without one the test is skipped."""
    found = program()
    if found is None:
        pytest.skip("there is no chromium on PATH: apt-get install chromium")
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=A_WHILE)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=found, args=[*OPTIONS], timeout=A_WHILE
        )
        yield chromium
        chromium.close()


class Watched:
    """What a page complained about, and whom it asked for something."""

    def __init__(self, page: Page) -> None:
        self.errors: list[str] = []
        self._requests: list[str] = []
        page.on("console", self._said)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self._requests.append(request.url))
        page.on("websocket", lambda socket: self._requests.append(socket.url))

    def _said(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.errors.append(message.text)

    def beyond(self, *origins: str) -> list[str]:
        """Requests that went elsewhere."""
        own = (*origins, "data:", "blob:")
        return [url for url in self._requests if not url.startswith(own)]
