"""One Chromium for all tests of the page; without one they are skipped, and say so."""

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("playwright")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from _studio_screen import chromium_path

NONE = (
    "no Chromium: the studio's page is not tested in a browser. Install one (Debian: apt install chromium), name it in "
    "FARFIELD_CHROMIUM, or run `make test-browser`"
)


@pytest.fixture(scope="module")  # its loop must not outlive the tests of the page: others run loops of their own
def chromium() -> Iterator[Any]:
    """A running browser."""
    path = chromium_path()
    if path is None:
        pytest.skip(NONE)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path)
        yield browser
        browser.close()
