"""What an adaptation changed, on one self-contained page: boxes, scores, pictures, the course of the training."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from farfield.figures.adapted_plots import boxes_before_and_after, score_histograms
from farfield.figures.courses import ADAPTATION, courses
from farfield.figures.style import figure_uri
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Frame, Key
from farfield.pages.adapted_scores import HeldScores
from farfield.pages.template import PageImage, render_template


@dataclass(frozen=True, eq=False)
class PseudoLabelFrame:
    """A frame of the target with its sure boxes before and after.

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
        positive: Scores from which boxes are sure, by class.
        negative: Scores below which they are background.
        source_rate: Sure boxes a sweep of the source.
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
    sure = [float(each[:, :, 0].sum()) for each in (before, after)]
    return render_template(
        "adapted.html",
        page=page,
        headline=(
            f"{sure[0]:.1f} sure boxes a sweep before, {sure[1]:.1f} after; the source, on which the detector learnt, "
            f"has {page.source_rate:.1f}. More boxes are not better ones: look at the pictures"
            + (", and at the scores." if page.scores else ", and score the weights on labels where you have some.")
        ),
        origin=_origin(page.simulated),
        table=_table(page, before, after),
        bins=_bins(page.edges_m),
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
    """Sure and unsure boxes a sweep by class and range bin, shape (classes, bins, 2).

    Boxes beyond the last edge count in no bin.
    """
    found = np.zeros((len(page.classes), len(page.edges_m) - 1, 2))
    for each in boxes.values():
        score = np.zeros(len(each)) if each.score is None else each.score
        place = np.digitize(each.range_m, page.edges_m) - 1
        inside = (place >= 0) & (place < found.shape[1])
        for row, name in enumerate(page.classes):
            mine = inside & (np.asarray(each.label) == name)
            sure, unsure = mine & (score >= page.positive[name]), mine & (score >= page.negative[name])
            for part, chosen in enumerate((sure, unsure & ~sure)):
                np.add.at(found[row, :, part], place[chosen], 1)
    return found / max(len(boxes), 1)


def _bins(edges_m: Sequence[float]) -> list[str]:
    return [*(f"{low:g} to {high:g} m" for low, high in pairwise(edges_m)), "all"]


def _table(page: AdaptedPage, before: np.ndarray, after: np.ndarray) -> list[list[str]]:
    """Rows of the table: a class, then before and after in each bin and over all."""
    rows = []
    for row, name in enumerate(page.classes):
        for part, word in enumerate(("sure", "unsure")):
            old, new = (np.append(each[row, :, part], each[row, :, part].sum()) for each in (before, after))
            cells = [f"{first:.2f} → {last:.2f}" for first, last in zip(old, new, strict=True)]
            rows.append([f"{name.replace('_', ' ')}, {word}", *cells])
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
    caption = f"{len(change.before)} sure boxes before, {len(change.after)} after."
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
        "boxes; sure and ignored boxes a frame are the teacher's; docs/adaptation.md says how to read the others.",
        "The course of the training",
    )
