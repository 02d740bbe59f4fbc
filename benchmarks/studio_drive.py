"""A drive annotated from nothing through the studio's page: proposals, tracks, a review, and what then is stored."""

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from _gestures import Subject, subjects
from _report import Part, part_parser, run_parts
from _studio_screen import (
    Emptied,
    Hand,
    Screen,
    annotated,
    browser,
    chromium_path,
    emptied,
    kind_of,
    word_of,
)
from studio_fitting import simulated

from farfield.datasets import open_dataset
from farfield.frame import Boxes
from farfield.geometry.iou import pairwise_iou

DETECTOR = "pointpillars-kradar-sim"
SEED = 77  # of a drive that nothing was chosen on
REACH_M, LEAST_POINTS = 60.0, 20  # what a person is asked for
SAME, GOOD = 0.1, 0.5  # overlap from above: of one object, and of a box that stands as it is
JOBS = "[...farfieldTest.state.jobs.values()].map((job) => job.state)"


@dataclass(eq=False)
class Worker:
    """A hand that annotates one drive, and what it did.

    Args:
        hand: With its errors.
        truth: Objects of each frame that a person is asked for.
        others: All objects of each frame.
    """

    hand: Hand
    truth: Sequence[Sequence[Subject]]
    others: Sequence[Boxes]
    done: dict[str, int] = field(default_factory=dict)
    names: dict[int, tuple[int, int]] = field(default_factory=dict)  # of an object: its track, and a frame that has it

    @property
    def page(self) -> Screen:
        """Its window."""
        return self.hand.page

    def count(self, what: str, by: int = 1) -> None:
        """Note something done."""
        self.done[what] = self.done.get(what, 0) + by

    def stored(self) -> list[dict[str, Any]]:
        """The boxes of the frame shown that will be written."""
        return [row for row in self.page.boxes if row["state"] in ("accepted", "edited")]

    def select(self, row: dict[str, Any]) -> None:
        """Click a box in the list of objects."""
        self.page.page.locator(f"#objects tr[data-box='{row['id']}']").click()
        self.page.until(f"state.selection === '{row['id']}'")

    def propose(self, score: float) -> None:
        """Detect in the whole drive, then accept all proposals from a score on."""
        page = self.page
        page.page.locator("#infer label:has-text('as proposals') input").check()
        page.page.get_by_role("button", name="To the end of the drive").click()
        ended = f"state.jobs.size > 0 && !{JOBS}.some((state) => ['queued', 'running'].includes(state))"
        page.until(ended, seconds=1200)
        page.settled()
        page.page.locator("#proposals input").fill(str(score))
        page.page.locator("#proposals button").click()
        bar = page.page.locator(".bar:has-text('One undo')")
        bar.wait_for()
        said = bar.get_by_role("button").all_inner_texts()
        chosen = next(text for text in (*(each for each in said if "drive" in each), *said) if "Accept" in text)
        bar.get_by_role("button", name=chosen).click()
        page.settled()
        self.count("accepted at once", int(chosen.split()[1]))

    def review(self, frame: int) -> None:
        """Look at a frame: remove what is nothing, fit what is poor, draw what lacks, join tracks of one object."""
        self.page.go(frame)
        for row in self.stored():
            if not len(self.others[frame]) or _overlap([row], self.others[frame]).max() < SAME:
                self.select(row)
                self.page.press("Delete")
                self.page.settled()
                self.count("removed")
        for number, subject in enumerate(self.truth[frame]):
            self._object(frame, number, subject)

    def _object(self, frame: int, number: int, subject: Subject) -> None:
        page, rows = self.page, self.stored()
        overlap = _overlap(rows, subject.box)[:, 0]
        row = rows[int(overlap.argmax())] if len(rows) and overlap.max() >= SAME else None
        rng = np.random.default_rng([SEED, frame, number])
        if row is None:
            row = self._drawn(subject, rng)
            if row is None:
                return self.count("not drawn")
        elif overlap.max() < GOOD:
            self.select(row)
            page.press("x")
            page.settled()
            self.count("fitted again")
            if _overlap([page.selected], subject.box)[0, 0] < GOOD:
                self.hand.corrected(page.selected, subject, rng)
                self.count("dragged")
        assert subject.box.track_id is not None
        self._join(int(subject.box.track_id[0]), frame, page.box(row["id"]))
        return None

    def _drawn(self, subject: Subject, rng: np.random.Generator) -> dict[str, Any] | None:
        """A new box, carried on as long as its points tell where it goes."""
        page = self.page
        classes = page.tell("state.welcome.classes")
        name = word_of(classes, str(subject.box.label[0]))
        self.hand.choose(name, kind_of(classes, name, float(subject.box.size_m[0, 0])))
        row = self.hand.drawn(subject, rng)
        if row is not None:
            page.press("Shift+P")
            page.until("state.pending === 0", seconds=120)
            page.settled()
            self.count("drawn and carried on")
        return row

    def _join(self, name: int, frame: int, row: dict[str, Any]) -> None:
        """Merge the track of a box into that of the same object in an earlier frame."""
        track, before = self.names.get(name, (row["track"], frame))
        if row["track"] == track or row["track"] is None:
            self.names[name] = (track, frame)
            return
        page = self.page
        page.go(before)
        first = next((one for one in self.stored() if one["track"] == track), None)
        if first is not None:
            self.select(first)
            page.press("Shift+M")
            page.go(frame)
            self.select(row)
            page.press("Shift+M")
            page.settled()
            taken = page.box(row["id"])["track"] == track
            self.count("merged" if taken else "not merged: both in one frame")
        page.go(frame)
        self.names[name] = (page.box(row["id"])["track"], frame)


def _overlap(rows: Sequence[dict[str, Any]], boxes: Boxes) -> np.ndarray:
    table = np.array([row["box"] for row in rows], dtype=float).reshape(-1, 7)
    drawn = Boxes(centre_m=table[:, :3], size_m=table[:, 3:6], yaw_rad=table[:, 6])
    return np.asarray(pairwise_iou(drawn, boxes, kind="bev"))


def compared(worker: Worker, copy: Emptied) -> Iterator[str]:
    """Precision and recall of what stands in the label files against the truth, and the identities."""
    right = boxes = asked = hit = 0
    centre_m: list[float] = []
    names: dict[int, set[str]] = {}
    for labels, subjects_of, others in zip(copy.boxes(), worker.truth, worker.others, strict=True):
        near = [label for label in labels if np.hypot(*label.box[:2]) < REACH_M]
        rows = [{"box": label.box} for label in near]
        if rows and len(others):
            right += int((_overlap(rows, others).max(axis=1) >= GOOD).sum())
        boxes, asked = boxes + len(rows), asked + len(subjects_of)
        for subject in subjects_of:
            overlap = _overlap([{"box": label.box} for label in labels], subject.box)[:, 0]
            if len(overlap) and overlap.max() >= GOOD:
                label = labels[int(overlap.argmax())]
                hit += 1
                centre_m.append(float(np.hypot(*(np.array(label.box[:2]) - subject.box.centre_m[0, :2]))))
                assert subject.box.track_id is not None
                names.setdefault(int(subject.box.track_id[0]), set()).add(label.track)
    once = sum(len(tracks) == 1 for tracks in names.values())
    yield f"precision {right / max(boxes, 1):.3f} ({right} of {boxes} boxes), recall {hit / max(asked, 1):.3f} "
    yield f"   ({hit} of {asked} objects of {LEAST_POINTS} points or more within {REACH_M:g} m), overlap of {GOOD:g}"
    yield f"centre off by {np.median(centre_m or [np.nan]):.2f} m (median); {once} of {len(names)} objects: one track"


def everything(page: Screen, frames: int) -> list[list[tuple[Any, ...]]]:
    """All boxes of a drive as a window has them."""
    rows = []
    for frame in range(frames):
        page.go(frame)
        rows.append(
            sorted(
                (row["class_name"], row["track"], *np.round(row["box"], 3))
                for row in page.boxes
                if row["state"] in ("accepted", "edited")
            )
        )
    return rows


def run_drive(arguments: Sequence[str]) -> int:
    """A drive of 60 frames annotated from nothing through the page by a hand with errors.

        python benchmarks/studio_drive.py drive [--frames 60] [--every 10] [--work DIR]

    A simulated drive of K-Radar's car, of a seed that nothing was chosen on, loses its labels. A Chromium at ``farfield
    annotate`` detects in the whole drive by a bundled detector, accepts all proposals from a score on (Shift+Y), then
    looks at every tenth frame: it removes boxes of nothing, fits poor ones again, draws what lacks and carries it on
    (Shift+P), merges the tracks of one object (Shift+M), and saves. The button goes down 0.35 m beside an object's
    point, drags are 4 degrees off. The label files are compared with the truth; then the journal is opened again, and
    each frame of the new window has to hold the same boxes. The hand takes no time to think: minutes are those of
    machine and page. Exit status 1 where what is opened again differs.
    """
    parser = part_parser(run_drive.__doc__)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--every", type=int, default=10, help="frames from one that is reviewed to the next")
    parser.add_argument("--score", type=float, default=0.4, help="from which proposals are accepted")
    parser.add_argument("--work", type=Path, help="where frames are simulated and copied to")
    parser.add_argument("--picture", type=Path, help="where a screenshot goes")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as place, browser() as playwright:
        work = options.work or Path(place)
        drive = ("--frames", str(options.frames), "--sequences", "1", "--sensors", "os2-64", "--stride-s", "0.1")
        source = simulated(work / f"drive-{options.frames}", *drive, "--weather", "normal", seed=SEED)
        data = open_dataset(source)
        frames = [data[index] for index in range(len(data))]
        truth = [
            [
                one
                for one in subjects([("simulated", frame)])
                if one.range_m < REACH_M and len(one.own_m) >= LEAST_POINTS
            ]
            for frame in frames
        ]
        chromium = playwright.chromium.launch(executable_path=chromium_path())
        copy = emptied(source, work / "annotated")
        print(f"load     {os.getloadavg()[0]:.1f}")
        began = time.monotonic()
        with annotated(copy, chromium, "--detector", DETECTOR) as page:
            others = [Boxes.empty() if frame.boxes is None else frame.boxes for frame in frames]
            worker = Worker(Hand(page), truth, others)
            worker.propose(options.score)
            proposed = time.monotonic()
            for frame in sorted({*range(0, len(frames), options.every), len(frames) - 1}):
                worker.review(frame)
            reviewed = time.monotonic()
            if options.picture is not None:
                page.page.screenshot(path=str(options.picture))
            before = everything(page, len(frames))
        with annotated(copy, chromium) as page:
            again = everything(page, len(frames))
        chromium.close()
        found = list(compared(worker, copy))
    minutes = [(proposed - began) / 60, (reviewed - proposed) / 60]
    print(f"{len(frames)} frames; proposals {minutes[0]:.1f} minutes, review {minutes[1]:.1f} minutes")
    print("; ".join(f"{what}: {count}" for what, count in worker.done.items()))
    print("\n".join(found))
    print(f"saved, opened again: {'equal' if before == again else 'DIFFERENT'} in {sum(map(len, before))} boxes")
    return int(before != again)


if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, {"drive": Part(run_drive, "--frames 4 --every 3", exact=True)}))
