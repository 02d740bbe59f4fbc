"""A training and an adaptation on one self-contained page each: curves, warnings, boxes, scores, settings."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from farfield.figures.style import figure_uri
from farfield.figures.training_plots import (
    ADAPTATION,
    RUN,
    Row,
    boxes_before_and_after,
    columns_of,
    courses,
    has_level,
    score_histograms,
)
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Frame, Key
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of

# Scores of an adaptation on labelled frames that it did not learn from, for its page.

Interval = tuple[float, float]
NOTHING = "–"


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """A figure of a class before and after.

    Args:
        label: The class.
        annotated: Number of its annotated objects.
        figure: What was scored.
        before: The figure before; None where there is none.
        after: The figure after.
        before_interval: Its interval, 95 %, or None.
        after_interval: The same after.
        gain: After minus before.
        gain_interval: Its interval, 95 %.
    """

    label: str
    annotated: int
    figure: str
    before: float | None
    after: float | None
    before_interval: Interval | None
    after_interval: Interval | None
    gain: float | None
    gain_interval: Interval | None


@dataclass(frozen=True, kw_only=True)
class HeldScores:
    """Scores on labelled frames that were not learnt from.

    Args:
        rows: Figures by class.
        frames: Number of these frames.
        drives: Number of their drives.
        shared_drives: How many of these have other frames that were learnt from.
        grouped_by: What was drawn for the intervals: ``"sequences"``, or ``"frames"`` of one sequence.
        groups: How many of them.
    """

    rows: tuple[ScoreRow, ...]
    frames: int
    drives: int
    shared_drives: int
    grouped_by: str
    groups: int

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return asdict(self)

    @property
    def words(self) -> str:
        """What was scored, and what the intervals hold."""
        held = "drive" if self.drives == 1 else "drives"
        text = f"{self.frames} labelled frames of {self.drives} {held} that were not learnt from"
        if self.shared_drives:
            text += (
                f"; {self.shared_drives} of these drives had other frames that were, so scores may come out too good"
            )
        drawn = "drives" if self.grouped_by == "sequences" else "frames of the one drive"
        return (
            f"{text}. The labels were read at the end and decided nothing. Intervals, 95 %, are over draws of the "
            f"{drawn}: another training would give other figures, and that spread is not in them."
        )

    @property
    def lines(self) -> list[list[tuple[str, str]]]:
        """Rows of the table: each cell a figure and its interval."""
        return [
            [
                (row.label.replace("_", " "), ""),
                (f"{row.annotated:,}", ""),
                (row.figure, ""),
                _cell(row.before, row.before_interval),
                _cell(row.after, row.after_interval),
                _cell(row.gain, row.gain_interval, signed=True),
            ]
            for row in self.rows
        ]


def _cell(value: float | None, interval: Interval | None, *, signed: bool = False) -> tuple[str, str]:
    form = "+.3f" if signed else ".3f"
    if value is None:
        return NOTHING, ""
    return format(value, form), "" if interval is None else f"{interval[0]:{form}} to {interval[1]:{form}}"


@dataclass(frozen=True, eq=False)
class PseudoLabelFrame:
    """A frame of the target with its confident boxes before and after.

    Args:
        frame: The frame.
        cloud: Which of its clouds was read.
        before: Boxes that the detector found before.
        after: Boxes that it finds now.
    """

    frame: Frame
    cloud: str
    before: Boxes
    after: Boxes


@dataclass(frozen=True, eq=False, kw_only=True)
class AdaptedPage:
    """Everything that the page shows.

    Args:
        title: Its title.
        classes: The detector's classes.
        edges_m: Edges of the range bins.
        before: All scored boxes of the target before, by frame.
        after: All scored boxes after.
        positive: Scores from which boxes are confident, by class.
        negative: Scores below which they are background.
        source_rate: Confident boxes a sweep of the source.
        measured: Classes whose thresholds come from the source's scores.
        changes: Frames to show.
        rows: Rows of the training's log.
        signs: Failure modes that it shows.
        labels: What the target's labels show, if it has any: a sentence.
        simulated: Whether ``source`` and ``target`` are simulated.
        settings: What was set, by name.
        scores: Scores on labelled frames that were not learnt from, if the user gave any.
    """

    title: str
    classes: Sequence[str]
    edges_m: Sequence[float]
    before: Mapping[Key, Boxes]
    after: Mapping[Key, Boxes]
    positive: Mapping[str, float]
    negative: Mapping[str, float]
    source_rate: float
    measured: Sequence[str]
    changes: Sequence[PseudoLabelFrame]
    rows: Sequence[Mapping[str, float | int]]
    signs: Sequence[str]
    labels: str
    simulated: Mapping[str, bool]
    settings: Mapping[str, Any]
    scores: HeldScores | None = None


def write_adapted(path: Path, page: AdaptedPage) -> Path:
    """Write the page, all or nothing.

    Args:
        path: The HTML file.
        page: What it shows.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, render_adapted(page))
    return path


def render_adapted(page: AdaptedPage) -> str:
    """Return the page as HTML."""
    before, after = (rates(boxes, page) for boxes in (page.before, page.after))
    confident = [float(table[:, :, 0].sum()) for table in (before, after)]
    return render_template(
        "adapted.html",
        page=page,
        headline=(
            f"{confident[0]:.1f} confident boxes a sweep before, {confident[1]:.1f} after; the source, on which the "
            f"detector learnt, has {page.source_rate:.1f}. More boxes are not better ones: look at the pictures"
            + (", and at the scores." if page.scores else ", and score the weights on labels where you have some.")
        ),
        origin=_origin(page.simulated),
        table=_table(page, before, after),
        bins=[*(f"{start:g} to {end:g} m" for start, end in pairwise(page.edges_m)), "all"],
        thresholds=[
            [
                name.replace("_", " "),
                f"{page.positive[name]:.2f}",
                f"{page.negative[name]:.2f}",
                "the source's scores" if name in page.measured else "the literature: too few in the source",
            ]
            for name in page.classes
        ],
        histogram=_histogram(page),
        pictures=[_picture(change) for change in page.changes],
        course=_course(page.rows),
    )


def rates(boxes: Mapping[Key, Boxes], page: AdaptedPage) -> np.ndarray:
    """Confident and ignored boxes a sweep by class and range bin, shape (classes, bins, 2).

    Boxes beyond the last edge count in no bin.
    """
    counts = np.zeros((len(page.classes), len(page.edges_m) - 1, 2))
    for frame_boxes in boxes.values():
        score = np.zeros(len(frame_boxes)) if frame_boxes.score is None else frame_boxes.score
        range_bin = np.digitize(frame_boxes.range_m, page.edges_m) - 1
        inside = (range_bin >= 0) & (range_bin < counts.shape[1])
        for row, name in enumerate(page.classes):
            of_class = inside & (np.asarray(frame_boxes.label) == name)
            confident, above_negative = (of_class & (score >= limit[name]) for limit in (page.positive, page.negative))
            for part, chosen in enumerate((confident, above_negative & ~confident)):
                np.add.at(counts[row, :, part], range_bin[chosen], 1)
    return counts / max(len(boxes), 1)


def _table(page: AdaptedPage, before: np.ndarray, after: np.ndarray) -> list[list[str]]:
    """Rows of the table: a class, then before and after in each bin and over all."""
    rows = []
    for row, name in enumerate(page.classes):
        for part, kind in enumerate(("confident", "ignored")):
            old, new = (np.append(table[row, :, part], table[row, :, part].sum()) for table in (before, after))
            cells = [f"{first:.2f} → {last:.2f}" for first, last in zip(old, new, strict=True)]
            rows.append([f"{name.replace('_', ' ')}, {kind}", *cells])
    return rows


def _origin(simulated: Mapping[str, bool]) -> str:
    """What is simulated and what is real."""
    source, target = ("simulated" if simulated[name] else "recorded" for name in ("source", "target"))
    end = " What is gained on simulated sweeps says little of real ones." if simulated["target"] else ""
    return f"The source frames are {source}, the target's are {target}.{end}"


def _histogram(page: AdaptedPage) -> PageImage:
    return PageImage(
        figure_uri(score_histograms(page.before, page.after, page.classes, page.positive, page.negative)),
        "Histograms of the scores of all boxes before and after, a panel for each class",
        "Boxes a sweep by score, on a logarithmic scale. The dashed lines are the thresholds: boxes right of both "
        "taught as objects, those left of both as background, and what lies between was ignored. A healthy adaptation "
        "empties the band between.",
    )


def _picture(change: PseudoLabelFrame) -> PageImage:
    frame = change.frame
    caption = f"{len(change.before)} confident boxes before, {len(change.after)} after."
    if frame.boxes is not None:
        caption += " Annotated boxes are drawn too; they were not used."
    return PageImage(
        figure_uri(boxes_before_and_after(frame, change.cloud, change.before, change.after)),
        f"Bird's-eye view of {frame.sequence}, {frame.frame_id}, with the boxes before above those after",
        caption,
        f"{frame.sequence}, frame {frame.frame_id}",
    )


def _course(rows: Sequence[Mapping[str, float | int]]) -> PageImage | None:
    figure = courses(rows, ADAPTATION)
    if figure is None:
        return None
    return PageImage(
        figure_uri(figure),
        "Curves of the losses and of what else was logged over the steps of all rounds",
        "Every logged step, the rounds one after the other. Losses are those of the labelled source and of the pseudo "
        "boxes; confident and ignored boxes a frame are the teacher's; docs/adaptation.md says how to read the others.",
        "The course of the training",
    )


# The course of a training on one self-contained page: curves, what the log warns of, settings.

_LAST = 20  # losses are means over this part of the steps


@dataclass(frozen=True, kw_only=True)
class CoursePage:
    """Everything that the page shows.

    Args:
        title: Its title.
        steps: Steps that are wanted.
        rows: Rows of the log, by step.
        signs: Failure modes that it shows, one sentence each.
        settings: What was set, by name.
    """

    title: str
    steps: int
    rows: Sequence[Row]
    signs: Sequence[str]
    settings: Mapping[str, object]

    @property
    def headline(self) -> str:
        """How far it is."""
        step = int(self.rows[-1]["step"]) if self.rows else 0
        return (
            f"All {count_of(self.steps, 'step is', 'steps are')} done."
            if step >= self.steps
            else f"{step} of {count_of(self.steps, 'step')} are done."
        )

    @property
    def last(self) -> list[tuple[str, str, str]]:
        """Each figure at the end: its name, the step that it is of, its value."""
        losses = set(columns_of(self.rows, RUN[0], RUN))
        names = dict.fromkeys(name for panel in RUN for name in columns_of(self.rows, panel, RUN))
        return [self._last_of(name, mean=name in losses) for name in names]

    def _last_of(self, name: str, *, mean: bool) -> tuple[str, str, str]:
        having = [row for row in self.rows if name in row]
        values = [row[name] for row in having][-max(1, len(having) // _LAST) :] if mean else [having[-1][name]]
        return name.replace("_", " "), str(having[-1]["step"]), f"{sum(values) / len(values):.4g}"


def write_course(path: Path, page: CoursePage) -> Path:
    """Write the page, all or nothing.

    Args:
        path: The HTML file.
        page: What it shows.
    """
    figure = courses(page.rows, RUN)
    course = None
    if figure is not None:
        course = PageImage(
            figure_uri(figure),
            "Curves of the losses and of what else was logged over the steps",
            "Every logged step; over long curves their running mean."
            + (" Dashed: the accuracy of guessing." if has_level(page.rows, RUN) else "")
            + " docs/adaptation.md says how to read what a method logs.",
            "The course of the training",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, render_template("course.html", page=page, course=course))
    return path
