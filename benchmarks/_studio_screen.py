"""A window of the studio in a real browser, a hand at its page, and data sets that it annotates anew."""

import contextlib
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from _gestures import Errors, Subject, compared, pressed
from _report import MissingError
from _studio_process import started

from farfield.annotation.schema import cirrus_class
from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.labels import BoxLabel
from farfield.datasets.labels.formats import label_files_in, label_format
from farfield.frame import Boxes

# A window of the studio in a real browser: clicks, drags and keys as a person makes them.


SIZE = {"width": 1280, "height": 800}


class Running(Protocol):
    """A studio that can be entered."""

    origin: str
    cookie: str


def chromium_path() -> str | None:
    """The browser: FARFIELD_CHROMIUM, or one of the system."""
    named = os.environ.get("FARFIELD_CHROMIUM")
    return named or next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """Playwright, where it and a browser are installed."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise MissingError("Playwright is not installed") from None
    if chromium_path() is None:
        raise MissingError("no Chromium; see `make test-browser`")
    with sync_playwright() as playwright:
        yield playwright


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
def screen(
    chromium: Any, live: Running, *, frame: int = 0, downloads: Path | None = None, script: str = ""
) -> Iterator[Screen]:
    """Open a window of a running studio with the cookie of its printed link; a script runs before the page's own."""
    name, _, value = live.cookie.partition("=")
    context = chromium.new_context(viewport=SIZE, accept_downloads=downloads is not None)
    context.add_cookies([{"name": name, "value": value, "url": live.origin}])
    page = context.new_page()
    if script:
        page.add_init_script(script)
    shown = Screen(page, live.origin)
    try:
        page.goto(f"{live.origin}/?test=1&frame={frame}")
        shown.settled()
        yield shown
    finally:
        context.close()


# A hand at the studio's page: brings places into sight with the wheel, presses beside objects, drags a little off.


DRAG_M = {True: 3.0, False: 1.5}  # vehicles, and what is small
PIXELS_A_METRE = {True: 24.0, False: 60.0}
HAND_PX, CLOSE_PX = 1.0, 60
_EDGE_PX, _STEPS = 100, 200


@dataclass(frozen=True, eq=False)
class Hand:
    """What a person does with mouse and keys, with errors of a normal distribution.

    Args:
        page: A window that annotates.
        error_m: How far beside its target the button goes down, metres in x and in y.
        error_deg: How far a drag is off the heading, degrees.
    """

    page: Screen
    error_m: float = 0.35
    error_deg: float = 4.0

    def bring(self, place: Sequence[float], pixels_a_metre: float) -> tuple[float, float]:
        """Bring a place into sight from above, by the wheel at it; gives its pixel.

        Raises:
            AssertionError: If the wheel does not bring it.
        """
        page = self.page
        if not page.tell("stage.eye.top"):
            page.press("t")
        area = page.page.locator("#main").bounding_box()
        middle = (area["x"] + area["width"] / 2, area["y"] + area["height"] / 2)
        for _ in range(_STEPS):
            at, beside = page.pixel(place), page.pixel([place[0] + 1, *place[1:]])
            inside = all(
                abs(at[i] - middle[i]) < area[side] / 2 - _EDGE_PX for i, side in ((0, "width"), (1, "height"))
            )
            near = math.dist(at, beside) / pixels_a_metre
            if inside and 1 <= near < 2:
                page.settled()
                return at
            self._uncover(at if inside else middle)
            page.page.mouse.move(*(at if inside else middle))
            before = page.tell("stage.eye.distance")
            if (
                not inside and before >= 800
            ):  # all of the scene was passed by: back to the road ahead, not to what is selected
                page.press("Escape", "Escape", "Enter")
                continue
            turns = 1 if inside and 0.4 <= near < 5 else 4  # far from it a hand turns the wheel faster
            page.page.mouse.wheel(0, turns * (60 if not inside or near >= 2 else -60))
            page.until(f"stage.eye.distance !== {before}")
        eye = page.tell("stage.eye.target"), page.tell("stage.eye.distance")
        raise AssertionError(f"the wheel did not bring {place} into sight: it is at {at} of {area}, the eye {eye}")

    def choose(self, name: str, kind: str = "") -> None:
        """Choose class and type of what is drawn next, with nothing selected."""
        page = self.page
        page.press("Escape", "Escape")
        spec = next(row for row in page.tell("state.welcome.classes") if row["name"] == name)
        if spec["key"]:
            page.press(spec["key"])
        else:
            page.page.locator("#inspector select[name='new class']").select_option(name)
        if kind:
            page.page.locator("#inspector select[name='new type']").select_option(kind)

    def drawn(self, subject: Subject, rng: np.random.Generator) -> dict[str, Any] | None:
        """Press beside one of the object's points and drag along its heading; the box, None where none came."""
        page, z = self.page, float(subject.box.centre_m[0, 2])
        start = pressed(subject, rng, self.error_m)
        yaw = float(subject.box.yaw_rad[0]) + math.radians(rng.normal(0, self.error_deg))
        end = start + DRAG_M[subject.vehicle] * np.array([math.cos(yaw), math.sin(yaw)])
        self.bring([*((start + end) / 2), z], PIXELS_A_METRE[subject.vehicle])
        page.press("n")
        return self._fitted(lambda: page.drag(self._pixel([*start, z]), self._pixel([*end, z])))

    def corrected(self, row: dict[str, Any], subject: Subject, rng: np.random.Generator) -> dict[str, Any] | None:
        """Drag an edge or the middle of the close-up from above, whichever fixes most, to a pixel beside its place."""
        x, y, z, length, width, _, yaw = row["box"]
        ahead, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
        away = subject.box.centre_m[0, :2] - (x, y)
        moves = [(0.0, np.array([x, y]), away)]  # what remains of the centre's error, from where, how far
        for axis, drawn, true in ((ahead, length, subject.box.size_m[0, 0]), (left, width, subject.box.size_m[0, 1])):
            for side in (1, -1):
                off = float(away @ axis) + side * (float(true) - drawn) / 2
                rest = float(np.linalg.norm(away - off / 2 * axis))
                moves.append((rest, np.array([x, y]) + side * drawn / 2 * axis, off * axis))
        _, from_m, by_m = min(moves, key=lambda each: each[0])
        self._enlarge([x, y, z])
        start, end = (self._close([*place, z]) for place in (from_m, from_m + by_m))
        self.page.drag(start, tuple(np.array(end) + rng.normal(0, HAND_PX, 2)))
        self.page.settled()
        return self.page.selected

    def _enlarge(self, middle: Sequence[float]) -> None:
        """Turn the wheel over the close-up from above until a metre is 60 pixels long, or it goes no nearer."""
        beside, before = (middle[0] + 1, *middle[1:]), 0.0
        while before < (now := math.dist(self._close(middle), self._close(beside))) < CLOSE_PX:
            self.page.page.mouse.move(*self._close(middle))
            self.page.page.mouse.wheel(0, -120)
            self.page.page.wait_for_timeout(100)
            before = now

    def _close(self, place: Sequence[float]) -> tuple[float, float]:
        """The pixel of a place in the close-up from above."""
        found = self.page.tell(f"closeUp('top', {list(map(float, place))})")
        return found[0], found[1]

    def peak(self, place: Sequence[float]) -> dict[str, Any] | None:
        """Double click on the radar's map."""
        self.bring([*place[:2], 0.0], PIXELS_A_METRE[True])
        at = self._pixel([*place[:2], 0.0])
        return self._fitted(lambda: self.page.page.mouse.dblclick(*at))

    def raised(self, subject: Subject, rng: np.random.Generator, error_px: float) -> dict[str, Any] | None:
        """Drag bottom and top of the selected box in the radar's close-up to pixels beside the object's."""
        page = self.page
        button = page.page.locator("button[name='large radar']")
        button.click()
        page.settled()
        for side in (-1, 1):
            x, y, z, *_, height, _ = page.selected["box"]
            target = float(subject.box.centre_m[0, 2] + side * subject.box.size_m[0, 2] / 2)
            start = page.tell(f"closeUp('radar', {[x, y, z + side * height / 2]})")
            end = page.tell(f"closeUp('radar', {[x, y, target]})")
            page.drag((start[0], start[1]), (end[0], end[1] + rng.normal(0, error_px)))
            page.settled()
        button.click()
        page.settled()
        return page.selected

    def locked(self, box: Sequence[float], track: int) -> None:
        """Select an object that is annotated and lock its size.

        Raises:
            AssertionError: If another object is selected.
        """
        page = self.page
        page.press("Escape", "Escape")
        page.page.mouse.click(*self.bring(box[:3], PIXELS_A_METRE[True]))
        page.until(f"state.carried?.track === {track}")
        page.press("Control+l")
        page.until(f"state.tracks.get({track}).size_locked === true && farfieldTest.state.pending === 0")

    def _pixel(self, place: Sequence[float]) -> tuple[int, int]:
        x, y = self.page.pixel(place)
        self._uncover((x, y))
        return round(x), round(y)

    def _uncover(self, at: tuple[float, float]) -> None:
        """Close the bars that lie over a pixel, as a person does who wants to work there."""
        over = f"document.elementFromPoint({at[0]}, {at[1]})?.closest('#bars .bar')"
        while self.page.page.evaluate(f"!!{over}"):
            self.page.page.evaluate(f"{over}.querySelector('button[title=Close]').click()")

    def _fitted(self, gesture: Any) -> dict[str, Any] | None:
        page = self.page
        before = page.tell("fitTimes.length")
        gesture()
        try:
            page.until(f"fitTimes.length > {before}", seconds=20)
        except AssertionError:
            page.press("Escape")
            return None
        page.settled()
        return page.selected


def word_of(classes: Sequence[dict[str, Any]], label: str) -> str:
    """The class of the page whose name means a label.

    Raises:
        StopIteration: If there is none.
    """
    return next(row["name"] for row in classes if row["name"] == label or cirrus_class(row["name"]) == label)


def kind_of(classes: Sequence[dict[str, Any]], name: str, length_m: float) -> str:
    """The type of a class whose usual length is nearest, as a person tells a bus from a van; empty for the class."""
    spec = next(row for row in classes if row["name"] == name)
    kinds = [(abs(spec["size"][0] - length_m), "")]
    kinds += [(abs(kind["size"][0] - length_m), kind["name"]) for kind in spec["types"]]
    return min(kinds)[1]


def usual_length_m(classes: Sequence[dict[str, Any]], name: str, length_m: float) -> float:
    """The length that the page takes for a class and the type that a person chooses."""
    spec, kind = next(row for row in classes if row["name"] == name), kind_of(classes, name, length_m)
    return next((float(each["size"][0]) for each in spec["types"] if each["name"] == kind), float(spec["size"][0]))


# Copies of data sets without their boxes, annotated anew in a studio; and the boxes of the label files that result.


CSV = "labels.csv"  # of data sets whose own label files are not edited


@dataclass(frozen=True, eq=False)
class Emptied:
    """A copy of a data set.

    Args:
        folder: Its folder; the journal stands beside it.
    """

    folder: Path

    @property
    def journal(self) -> Path:
        return self.folder.with_name(f"{self.folder.name}-edits")

    @property
    def saved(self) -> Path:
        return self.folder.with_name(f"{self.folder.name}-saved")

    def open(self) -> Dataset:
        return open_dataset(self.folder)

    def boxes(self) -> list[tuple[BoxLabel, ...]]:
        """What stands in the label files, frame by frame."""
        data = self.open()
        files = label_format(data) or label_files_in(self.saved / CSV, "boxes-csv")
        found = []
        for key in data.keys:
            path = files.path(key)
            found.append(files.parse(path.read_bytes(), path, [key]).get(key, ()) if path.is_file() else ())
        return found


def emptied(source: Path, folder: Path, frames: Sequence[int] | None = None) -> Emptied:
    """Copy a data set and take the boxes out of its label files.

    Args:
        source: The data set.
        folder: Where the copy is made; what is there already goes.
        frames: Numbers of the frames that lose their boxes; all unless given.
    """
    copy = Emptied(folder)
    for each in (folder, copy.journal, copy.saved):
        shutil.rmtree(each, ignore_errors=True)
    shutil.copytree(source, folder)
    data = open_dataset(folder)
    files = label_format(data)
    for index in range(len(data)) if frames is None else frames:
        key = data.keys[index]
        if files is not None:
            path = files.path(key)
            path.write_bytes(files.render(path.read_bytes(), path, {key: ()}))
    if files is None:
        assert frames is None
        for path in folder.rglob("label_2/*.txt"):
            path.write_bytes(b"")
    return copy


@contextlib.contextmanager
def annotated(copy: Emptied, chromium: Any, *arguments: str) -> Iterator[Screen]:
    """A window of ``farfield annotate``; the label files are written when this ends, in their places where they can."""
    place = ("--write",) if label_format(copy.open()) is not None else ("--out", str(copy.saved))
    given = (*place, "--extent", "full", "--annotator", "hand", "--edits", str(copy.journal), *arguments)
    with started("annotate", str(copy.folder), *given) as live, screen(chromium, live) as page:
        assert page.tell("colours()") > 20, "the canvas is blank"
        yield page
        page.press("Control+s")
        page.page.locator(".bar:has-text('label file')").wait_for(timeout=30_000)
        assert page.errors == [], page.errors
        assert page.foreign == [], page.foreign


def written(labels: Sequence[BoxLabel], box: Sequence[float]) -> BoxLabel:
    """The label of a box of the page.

    Raises:
        AssertionError: If none is within 2 mm of it.
    """
    apart = [float(np.abs(np.subtract(label.box[:6], box[:6])).max()) for label in labels]
    assert apart, "the file of this frame has no box"
    assert min(apart) < 2e-3, f"the file's nearest box is {min(apart):.3f} m from the page's"
    return labels[int(np.argmin(apart))]


def errors_of(
    copy: Emptied, chosen: Sequence[tuple[int, Subject]], made: Sequence[dict[str, Any] | None]
) -> tuple[Errors, np.ndarray]:
    """Errors of the boxes in the label files, and which of the objects have one.

    Args:
        copy: The copy whose files were written.
        chosen: Frame and object.
        made: What the page drew for each, None where nothing came.

    Raises:
        AssertionError: If a box of the page is not in its frame's file.
    """
    files = copy.boxes()
    rows = np.full((len(chosen), 7), np.nan)
    for place, ((frame, _), row) in enumerate(zip(chosen, made, strict=True)):
        if row is not None:
            rows[place] = written(files[frame], row["box"]).box
    there = np.isfinite(rows[:, 0])
    boxes = Boxes(centre_m=rows[there, :3], size_m=rows[there, 3:6], yaw_rad=rows[there, 6]).replace(label="unknown")
    truth = Boxes.concatenate([one.box.plain() for (_, one), held in zip(chosen, there, strict=True) if held])
    return compared(boxes, truth, np.zeros(0)), there
