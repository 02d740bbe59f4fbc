"""A hand at the studio's page: brings places into sight with the wheel, presses beside objects, drags a little off."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from _gestures import Subject, pressed
from _studio_screen import Screen

from farfield.annotation.schema import cirrus_class

DRAG_M = {True: 3.0, False: 1.5}  # vehicles, and what is small
_PIXELS_A_METRE = {True: 24.0, False: 60.0}
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
        self.bring([*((start + end) / 2), z], _PIXELS_A_METRE[subject.vehicle])
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
        self.bring([*place[:2], 0.0], _PIXELS_A_METRE[True])
        at = self._pixel([*place[:2], 0.0])
        return self._fitted(lambda: self.page.page.mouse.dblclick(*at))

    def locked(self, box: Sequence[float], track: int) -> None:
        """Select an object that is annotated and lock its size.

        Raises:
            AssertionError: If another object is selected.
        """
        page = self.page
        page.press("Escape", "Escape")
        page.page.mouse.click(*self.bring(box[:3], _PIXELS_A_METRE[True]))
        page.until(f"state.carried?.track === {track}")
        page.press("Control+l")
        page.until(f"state.tracks.get({track}).size_locked === true && farfieldTest.state.pending === 0")

    def _pixel(self, place: Sequence[float]) -> tuple[int, int]:
        x, y = self.page.pixel(place)
        return round(x), round(y)

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
