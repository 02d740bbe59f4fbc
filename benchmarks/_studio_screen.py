"""A window of the studio in a real browser: clicks, drags and keys as a person makes them."""

import contextlib
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

SIZE = {"width": 1280, "height": 800}


class Running(Protocol):
    """A studio that can be entered."""

    origin: str
    cookie: str


def chromium_path() -> str | None:
    """The browser: FARFIELD_CHROMIUM, or one of the system."""
    named = os.environ.get("FARFIELD_CHROMIUM")
    return named or next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Screen:
    """A page of the studio.

    Args:
        page: Playwright's page.
        origin: Scheme, host and port of the studio.
    """

    def __init__(self, page: Any, origin: str) -> None:
        self.page, self.origin = page, origin
        self.foreign: list[str] = []
        self.errors: list[str] = []
        page.on("request", self._count)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda line: self.errors.append(line.text) if line.type == "error" else None)

    def _count(self, request: Any) -> None:
        if not request.url.startswith((self.origin, self.origin.replace("http", "ws"), "data:", "blob:")):
            self.foreign.append(request.url)

    def tell(self, code: str, *arguments: Any) -> Any:
        """Evaluate something of ``window.farfieldTest``."""
        return self.page.evaluate(f"farfieldTest.{code}", *arguments)

    def settled(self) -> float:
        """Wait until what is asked for is drawn and saved; milliseconds waited."""
        return self.tell("waitIdle()")

    def press(self, *keys: str) -> None:
        """Press keys one after the other."""
        for key in keys:
            self.page.keyboard.press(key)

    def go(self, frame: int) -> None:
        """Step to a frame with the keys."""
        while (now := self.tell("state.frame")) != frame:
            self.press("ArrowRight" if frame > now else "ArrowLeft")
        self.settled()

    def pixel(self, place: Sequence[float]) -> tuple[float, float]:
        """Where a place of the frame is on the screen."""
        found = self.tell(f"project({list(map(float, place))})")
        assert found is not None, f"{place} is behind the eye"
        return found[0], found[1]

    def look(self, x: float, y: float, reach: float, *, top: bool = True) -> None:
        """Look at a place."""
        self.tell(f"look([{float(x)}, {float(y)}, 0], {float(reach)}, {str(top).lower()})")
        self.settled()

    def click(self, place: Sequence[float]) -> None:
        """Click at a place of the frame."""
        self.page.mouse.click(*self.pixel(place))

    def drag(self, start: tuple[float, float], end: tuple[float, float], *, steps: int = 8) -> None:
        """Press at a pixel, move, release at another."""
        mouse = self.page.mouse
        mouse.move(*start)
        mouse.down()
        mouse.move(*end, steps=steps)
        mouse.up()

    @property
    def boxes(self) -> list[dict[str, Any]]:
        """The boxes as the page has them."""
        return self.tell("state.boxes")

    @property
    def selected(self) -> dict[str, Any] | None:
        """The selected box."""
        chosen = self.tell("state.selection")
        return next((row for row in self.boxes if row["id"] == chosen), None)

    def box(self, name: str) -> dict[str, Any]:
        """A box by its identity."""
        return next(row for row in self.boxes if row["id"] == name)

    def text(self, selector: str) -> str:
        """The text of an element."""
        return self.page.locator(selector).inner_text()

    def until(self, code: str, *, seconds: float = 10.0) -> None:
        """Wait until something of the page is true."""
        for _ in range(int(seconds / 0.05)):
            if self.tell(code):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"{code} did not become true; the page says: {self.text('#bars')!r}, errors {self.errors}")


@contextlib.contextmanager
def screen(chromium: Any, live: Running, *, frame: int = 0, downloads: Path | None = None) -> Iterator[Screen]:
    """Open a window of a running studio with the cookie of its printed link."""
    name, _, value = live.cookie.partition("=")
    context = chromium.new_context(viewport=SIZE, accept_downloads=downloads is not None)
    context.add_cookies([{"name": name, "value": value, "url": live.origin}])
    page = context.new_page()
    shown = Screen(page, live.origin)
    try:
        page.goto(f"{live.origin}/?test=1&frame={frame}")
        shown.settled()
        yield shown
    finally:
        context.close()
