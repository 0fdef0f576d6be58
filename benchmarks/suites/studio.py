"""The studio in a browser: how soon it is painted, and how soon a slider shows.

Chromium draws with the processor, which a graphics card does faster.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import Any

from benchmarks.chromium import OPTIONS, program
from benchmarks.metric import Metric, Tell

_A_WHILE = 240_000  # milliseconds
_PAINTED = "() => performance.getEntriesByType('paint').at(-1)?.startTime"
# From a key on a slider to the frame after the one that shows what the server made of it.
_WATCH = """() => {
  window.waits = [];
  let pressed = 0, shown = '';
  document.addEventListener('keydown', () => { pressed = performance.now(); }, true);
  new MutationObserver(() => {
    const found = document.evaluate("//span[contains(., 'as the sliders say')]", document, null, 9, null);
    const text = found.singleNodeValue?.textContent ?? '';
    if (text === shown) return;
    shown = text;
    requestAnimationFrame(() => requestAnimationFrame(
      () => window.waits.push(performance.now() - pressed)));
  }).observe(document.body, {subtree: true, childList: true, characterData: true});
}"""


def run(quick: bool, tell: Tell) -> Iterator[Metric]:
    found = program()
    if found is None:
        note = "missing: Chromium; apt-get install chromium"
        yield Metric("studio.paint_over_viser", float("nan"), "×", "less", note=note)
        return
    import viser
    from playwright.sync_api import sync_playwright

    from petalfit.studio import Studio

    studio = Studio()
    with contextlib.redirect_stdout(io.StringIO()):
        bare = viser.ViserServer("127.0.0.1", 8190, verbose=False)
    urls = {"studio": studio.url, "viser": f"http://127.0.0.1:{bare.get_port()}"}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=[*OPTIONS])
        times: dict[str, list[float]] = {name: [] for name in urls}
        for k in range(3 if quick else 9):
            for name, url in urls.items():
                tell(f"first paint of {name}, {k + 1}")
                page = browser.new_page()
                page.goto(url)
                page.wait_for_function(_PAINTED, timeout=_A_WHILE)
                times[name].append(page.evaluate(_PAINTED) / 1000)
                page.close()
        ratios = [a / b for a, b in zip(times["studio"], times["viser"], strict=True)]
        yield Metric.median(
            "studio.paint_over_viser", ratios, "×", "less", tolerance=0.5,
            note=f"bare viser {viser.__version__}: {min(times['viser']):.2f} s",
        )  # fmt: skip
        tell("sliders")
        page = browser.new_page(viewport={"width": 900, "height": 600})
        waits = _sliders(page, studio.url, 8 if quick else 25)
        yield Metric.median(
            "studio.slider_seconds", waits, "s", "less",
            note="from the key to the second frame with the new petal's distances",
        )  # fmt: skip
        browser.close()
    studio.stop()
    with contextlib.redirect_stdout(io.StringIO()):
        bare.stop()


def _sliders(page: Any, url: str, steps: int) -> list[float]:
    """Seconds from keys to frames, the first of which is discarded."""
    page.goto(url)
    go = page.get_by_role("button", name="Fit", exact=True)
    go.click(timeout=_A_WHILE)
    page.get_by_text("converged").wait_for(timeout=_A_WHILE)
    page.wait_for_timeout(5000)  # until it has settled
    page.evaluate(_WATCH)
    thumb = page.get_by_role("slider").nth(2)
    thumb.focus()
    for _ in range(steps):
        thumb.press("ArrowRight")
        page.wait_for_timeout(500)
    return [wait / 1000 for wait in page.evaluate("() => window.waits")[1:]]
