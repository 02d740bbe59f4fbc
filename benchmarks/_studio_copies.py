"""Copies of data sets without their boxes, annotated anew in a studio; and the boxes of the label files that result."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from _gestures import Errors, Subject, compared
from _studio_process import started
from _studio_screen import Screen, screen

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.labels import BoxLabel
from farfield.datasets.labels.formats import label_files_in, label_format
from farfield.frame import Boxes

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
