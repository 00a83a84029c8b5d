"""The browser that draws pages for tests: a Chromium of the machine's own, which no package of PyPI carries."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

#: Names under which distributions install it; `scripts/test` looks for the same.
NAMES = ("chromium", "chromium-browser", "google-chrome")


def executable() -> str:
    """Path of the browser; FileNotFoundError, which says what to install, where there is none."""
    for name in NAMES:
        if found := shutil.which(name):
            return found
    raise FileNotFoundError(f"no browser ({', '.join(NAMES)}): 'apt-get install chromium'")


@contextmanager
def launched(*arguments: str) -> Iterator[Browser]:
    """Run the browser without a window, for as long as the context lasts."""
    path = executable()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-gpu", "--disable-quic", *arguments]
        )
        yield browser
        browser.close()
