import warnings

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

from farfield.evaluation.record import Evaluation
from farfield.figures.birds_eye import (
    SHORT_WINDOW_M,
    WINDOW_M,
    ZOOMS_M,
    birdseye,
    filled_zooms,
    fitting_window,
    overview,
    show_frame,
    zooms,
)
from farfield.figures.camera import box_lines, camera_picture
from farfield.figures.plots import points_against_range, precision_recall, scan_patterns
from farfield.figures.style import figure_bytes
from farfield.frame import Cloud, Frame
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera

CAR = Boxes(
    centre_m=np.array([[30.0, 5.0, -1.0]]), size_m=np.array([[4.0, 2.0, 1.5]]), yaw_rad=np.array([0.0]), label="vehicle"
)
CLOUD = Cloud(np.array([[10, 0, 0], [200, 10, 1], [300, 0, 0]], dtype=np.float32), np.ones(3, dtype=np.float32))


def test_birdseye_draws_boxes_at_their_metres_and_the_front_in_front() -> None:
    axes = overview(CLOUD, annotated=CAR, predicted=CAR).axes[0]
    outlines = [c for c in axes.collections if isinstance(c, PolyCollection)]
    assert len(outlines) == 2
    for outline in outlines:
        corners = outline.get_paths()[0].vertices
        assert corners.min(axis=0).tolist() == [28.0, 4.0]
        assert corners.max(axis=0).tolist() == [32.0, 6.0]
    heading = next(c for c in axes.collections if isinstance(c, LineCollection) and c.get_zorder() > 1).get_segments()[
        0
    ]
    assert heading.tolist() == [[30.0, 5.0], [32.0, 5.0]]
    assert axes.get_xlim() == (0.0, 250.0)
    assert axes.get_aspect() == 1.0


def test_points_outside_the_window_are_left_out() -> None:
    axes = overview(CLOUD).axes[0]
    marked = axes.images[0].get_array()[..., 3] > 0
    assert len(np.unique(np.argwhere(marked)[:, 1])) == 2


def test_zooms_show_near_mid_far() -> None:
    figure = zooms(CLOUD, annotated=CAR)
    assert [axes.get_xlim() for axes in figure.axes] == [(w[0], w[1]) for _, w in ZOOMS_M]


def test_pictures_leave_empty_range_out() -> None:
    near = Cloud(CLOUD.points_m[:1], CLOUD.intensity[:1])
    assert fitting_window(near, CAR, None) == SHORT_WINDOW_M
    assert fitting_window(CLOUD, CAR) == WINDOW_M
    assert fitting_window(near, CAR.replace(centre_m=np.array([[130.0, 0.0, 0.0]]))) == WINDOW_M
    assert [name for name, _ in filled_zooms(CLOUD, CAR)] == ["near: 0 to 70 m"]


def test_a_frame_is_cropped_to_sensor_points_and_boxes() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform([-35, -15, 0], [55, 25, 1], (5000, 3))
    points[0] = [240, 200, 0]  # a lone return
    frame = Frame.of(Cloud(points), CAR.replace(centre_m=np.array([[75.0, 0.0, 0.0]])))
    axes = birdseye(frame).axes[0]
    assert (*axes.get_xlim(), *axes.get_ylim()) == (-40, 80, -20, 30)
    ahead = birdseye(Frame.of(Cloud(points + np.array([100, 0, 0])))).axes[0]
    assert ahead.get_xlim() == (0, 160), "the sensor is shown"
    tall = birdseye(Frame.of(Cloud(points[:, [1, 0, 2]])))
    assert tall.get_figheight() < 10
    assert birdseye(Frame.of(Cloud(np.zeros((0, 3))))).axes[0].get_xlim() == (0, 250)


@pytest.mark.parametrize(
    "window_m", [(0.0, 10.0, 0.0, 0.0), (0.0, 10.0, -500.0, 500.0), (0.0, 100.0, 60.0, 120.0), (0.0, 0.0, 0.0, 0.0)]
)
def test_any_window_has_a_picture(window_m: tuple[float, float, float, float]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # matplotlib widens axes without extent
        figure = overview(CLOUD, annotated=CAR, window_m=window_m, rings_m=(20.0, 70.0), title="a long title " * 20)
        figure.draw_without_rendering()
    assert figure.get_figwidth() > 3
    assert figure.get_figheight() < 20
    shown = [text for text in figure.axes[0].texts if text.get_text().endswith(" m")]
    assert all(window_m[2] < text.xy[1] < window_m[3] for text in shown)


def test_points_without_place_are_not_cropped_to() -> None:
    points = np.random.default_rng(2).uniform([0, -15, 0], [95, 15, 1], (500, 3))
    points[::7] = np.nan
    assert birdseye(Frame.of(Cloud(points))).axes[0].get_xlim() == (0, 100)


def test_other_classes_are_grey() -> None:
    both = Boxes.concatenate([CAR, CAR.replace(label="pedestrian")])
    axes = overview(CLOUD, annotated=both, labels=("vehicle",)).axes[0]
    colours = {tuple(np.round(c.get_edgecolor()[0], 2)) for c in axes.collections if isinstance(c, PolyCollection)}
    assert len(colours) == 2


def test_show_frame_counts_what_was_found_and_opens_no_window_here() -> None:
    frame = Frame.of(CLOUD, CAR)
    figure = show_frame(frame, CAR.replace(score=np.array([0.5])))
    assert "1 of 1 annotated object within 2 m of a box" in figure.axes[0].get_title(loc="left")
    assert show_frame(Frame.of(CLOUD)).axes
    assert birdseye(frame, window_m="fit").axes[0].get_xlim() == (10.0, 300.0)


def test_camera_lines_are_the_projected_corners(camera: Camera) -> None:
    lines = box_lines(CAR.replace(centre_m=np.array([[20.0, 0.0, 0.0]])), camera)
    assert len(lines) == 12
    pixels = np.concatenate(lines)
    assert pixels[:, 0].max() == pytest.approx(60 + 60 * 1.0 / 18)  # half the width at the near face
    assert pixels[:, 1].max() == pytest.approx(40 + 60 * 0.75 / 18)
    assert box_lines(CAR.replace(centre_m=np.array([[-20.0, 0.0, 0.0]])), camera) == []
    assert box_lines(Boxes.empty(), camera) == []


def test_camera_without_calibration_shows_the_image_alone() -> None:
    figure = camera_picture(np.zeros((20, 30, 3), dtype=np.uint8), None, annotated=CAR)
    assert not figure.axes[0].collections


def test_curves_are_those_of_the_result(evaluation: Evaluation) -> None:
    figure = precision_recall(dict(evaluation.results))
    assert len(figure.axes) == 4
    shown = next(line for line in figure.axes[0].lines if line.get_label() == "within 2 m").get_ydata()
    given = np.array(evaluation.results["gaussian"]["curves"]["overall"]["0"]["2.0"]["precision"])
    assert np.array_equal(shown, given[: len(shown)])
    assert not given[len(shown) :].any()


def test_curves_of_nothing_say_so() -> None:
    result = {"curves": {"overall": {"0": {"2.0": None}}}}
    axes = precision_recall({"a": {"protocol": "dds", **result}}).axes[0]
    assert [text.get_text() for text in axes.texts] == ["nothing annotated"]


def test_points_and_patterns_can_be_drawn(evaluation: Evaluation) -> None:
    figure = points_against_range(evaluation.objects)
    assert "67% of 6 found" in figure.axes[0].get_title(loc="left")
    assert figure_bytes(figure, "png", dpi=40).startswith(b"\x89PNG")
    clouds = dict(evaluation.frames[0].frame.clouds)
    assert figure_bytes(scan_patterns(clouds), dpi=40).startswith(b"<?xml")
    empty = Cloud(np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.float32))
    assert figure_bytes(scan_patterns({"a": empty, "b": empty}), dpi=40)
