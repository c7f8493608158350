"""A headless browser. Run as a script it makes the picture of the results page: `python -m tests.report.browsers`."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

RESULTS = Path(__file__).parents[2] / "results"
QUIET = ("--disable-gpu", "--disable-background-networking", "--disable-component-update", "--no-first-run")


@contextmanager
def opened_browser() -> Iterator[Any]:
    """Chromium of the system, or the one that Playwright installed."""
    from playwright.sync_api import sync_playwright

    system = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    # A browser refuses to isolate itself for the administrator, as whom containers run.
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=system, args=[*QUIET, *root])
        yield browser
        browser.close()


def picture_of_results(path: Path) -> None:
    """The claims and the explorer of the results page side by side, and its width on a phone."""
    with opened_browser() as browser:
        shots = []
        for width, anchor in ((1100, "main"), (1100, "#explore"), (375, "header")):
            page = browser.new_page(viewport={"width": width, "height": 860})
            page.goto((RESULTS / "index.html").as_uri())
            page.wait_for_selector("#explorer svg")
            page.locator(anchor).first.evaluate("part => part.scrollIntoView()")
            if anchor == "#explore":
                page.locator("[data-role=chart]").focus()
                for _ in range(9):
                    page.keyboard.press("ArrowRight")
            shots.append(path.with_suffix(f".{len(shots)}.png"))
            page.screenshot(path=shots[-1])
        images = [Image.open(shot).convert("RGB") for shot in shots]
        whole = Image.new("RGB", (sum(image.width for image in images) + 40, 900), "#888888")
        left = 10
        for image in images:
            whole.paste(image, (left, 20))
            left += image.width + 10
        whole.quantize(255, dither=Image.Dither.NONE).save(path, optimize=True)
        for shot in shots:
            shot.unlink()


if __name__ == "__main__":
    picture_of_results(RESULTS / "page.png")
