"""The page of an adaptation, from boxes, scores and logs made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from farfield.figures.training_plots import ADAPTATION, courses
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame
from farfield.pages.training_pages import AdaptedPage, HeldScores, PseudoLabelFrame, ScoreRow, rates, render_adapted


def boxes_at(*x: float, score: tuple[float, ...], label: str = "vehicle") -> Boxes:
    n = len(x)
    return Boxes(
        centre_m=np.column_stack([x, np.zeros((n, 2))]),
        size_m=np.tile([4.5, 2.0, 1.6], (n, 1)),
        yaw_rad=np.zeros(n),
        label=label,
        score=np.array(score),
    )


@pytest.fixture
def frame(rng: np.random.Generator) -> Frame:
    points = rng.uniform([0, -20, -2], [100, 20, 1], size=(500, 3)).astype(np.float32)
    annotation = Annotation(boxes=boxes_at(20.0, score=(1.0,)).replace(score=None))
    return Frame(sequence="s", frame_id="0", clouds={"lidar": Cloud(points)}, load_annotation=Constant(annotation))


@pytest.fixture
def page(frame: Frame) -> AdaptedPage:
    before = {("s", "0"): boxes_at(20, 90, score=(0.7, 0.4)), ("s", "1"): boxes_at(20, 300, score=(0.7, 0.9))}
    after = {key: boxes_at(20, 90, score=(0.7, 0.65)) for key in before}
    return AdaptedPage(
        title="mine adapted to <theirs>",
        classes=("vehicle", "large_vehicle"),
        edges_m=[0.0, 70.0, 150.0],
        before=before,
        after=after,
        positive={"vehicle": 0.6, "large_vehicle": 0.5},
        negative={"vehicle": 0.3, "large_vehicle": 0.2},
        source_rate=7.25,
        measured=("vehicle",),
        changes=[PseudoLabelFrame(frame, "lidar", before["s", "0"][:1], after["s", "0"])],
        rows=[{"step": 1, "source_box": 1.0, "pseudo_boxes": 2.0}, {"step": 2, "source_box": 0.5, "rank_source": 9.0}],
        signs=["the rank falls"],
        labels="The target is annotated.",
        simulated={"source": True, "target": False},
        settings={"rounds": 2},
    )


def test_scores_stand_on_the_page_with_their_intervals(page: AdaptedPage) -> None:
    row = ScoreRow(
        label="large_vehicle",
        annotated=1234,
        figure="DDS",
        before=0.25,
        after=0.375,
        before_interval=(0.2, 0.3),
        after_interval=None,
        gain=0.125,
        gain_interval=(-0.01, 0.26),
    )
    held = HeldScores(rows=(row,), frames=40, drives=4, shared_drives=1, grouped_by="sequences", groups=4)
    text = render_adapted(replace(page, scores=held))
    for words in (
        "40 labelled frames of 4 drives",
        "1 of these drives had other frames that were",
        "decided nothing",
        "1,234",
        "0.250",
        "0.200 to 0.300",
        "+0.125",
        "-0.010 to +0.260",
    ):
        assert words in text, words
    assert "score the weights on labels" not in text
    nothing = render_adapted(replace(page, scores=replace(held, rows=(), shared_drives=0)))
    assert "None of the detector's classes is annotated there." in nothing
    assert "other frames that were" not in nothing


def test_rates_count_by_class_range_and_threshold(page: AdaptedPage) -> None:
    found = rates(page.before, page)
    assert found.shape == (2, 2, 2)
    assert found[0].tolist() == [[1.0, 0.0], [0.0, 0.5]]  # confident and ignored: near, far; 300 m is beyond the edges
    assert found[1].sum() == 0


def test_the_page_shows_rates_thresholds_pictures_and_signs(page: AdaptedPage) -> None:
    text = render_adapted(page)
    for words in (
        "mine adapted to &lt;theirs&gt;",
        "1.0 confident boxes a sweep before, 2.0 after",
        "has 7.2",
        "0.00 → 1.00",
        "the literature: too few in the source",
        "1 confident boxes before, 2 after.",
        "Annotated boxes are drawn too; they were not used.",
        "The source frames are simulated, the target&#39;s are recorded.",
        "the rank falls",
        "The target is annotated.",
    ):
        assert words in text, words
    assert text.count("data:image/svg+xml") == 3
    assert 'src="http' not in text


def test_what_there_is_not_is_left_out(page: AdaptedPage) -> None:
    text = render_adapted(replace(page, rows=[], signs=[], labels="", changes=[], before={}, after={}))
    assert "The course of the training" not in text
    assert "What the log warns of" not in text
    assert courses([{"step": 1, "loss": 2.0}], ADAPTATION) is None


def test_curves_have_a_panel_for_each_kind(page: AdaptedPage) -> None:
    figure: Any = courses([{**row, "round": number} for number, row in enumerate(page.rows, 1)], ADAPTATION)
    titles = [axes.get_title("left") for axes in figure.axes if axes.get_visible()]
    assert titles == ["loss of source and pseudo boxes", "boxes of the teacher a frame", "rank of the features"]
