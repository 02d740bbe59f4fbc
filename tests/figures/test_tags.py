"""Boxes in pictures say their class and score; a picture says which boxes it leaves out."""

import numpy as np
import pytest
from PIL import Image

import farfield as ff
from farfield.figures.birds_eye import overview
from farfield.figures.camera import camera_picture
from farfield.geometry.cameras import Camera
from farfield.vocabulary.scores import SHOWN_SCORE

CLOUD = ff.Cloud(np.array([[10.0, 0, 0], [60, 10, 1]]))
FOUND = ff.Boxes(
    centre_m=np.array([[30.0, 5.0, 0.0], [50.0, -5.0, 0.0]]),
    size_m=np.tile([4.0, 2.0, 1.5], (2, 1)),
    yaw_rad=np.zeros(2),
    label=np.array(["vehicle", "pedestrian"]),
    score=np.array([0.874, 0.12]),
)
# looks along x: u is -y, v is -z
CAMERA = Camera(
    matrix=np.array([[80.0, 0, 100], [0, 80, 60], [0, 0, 1]]),
    width_px=200,
    height_px=120,
    camera_T_lidar=np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
)


def tags(figure) -> set[str]:
    return {text.get_text() for text in figure.axes[0].texts} - {f"{ring} m" for ring in (20, 40, 60, 70, 80, 150, 250)}


def test_predicted_boxes_bear_class_and_score_from_above() -> None:
    assert tags(overview(CLOUD, predicted=FOUND)) == {"vehicle 0.87", "pedestrian 0.12"}
    both = overview(CLOUD, annotated=FOUND.plain(), predicted=FOUND)
    assert tags(both) == {"vehicle 0.87", "pedestrian 0.12"}, "no word twice in one place"
    assert tags(overview(CLOUD, annotated=FOUND.plain())) == {"vehicle", "pedestrian"}


def test_no_tag_covers_another() -> None:
    """Forty boxes on one spot: as many tags as have room, the surest among them; far apart all have theirs."""
    crowd = ff.Boxes(
        centre_m=np.column_stack([np.linspace(30, 32, 40), np.zeros(40), np.zeros(40)]),
        size_m=np.tile([4.0, 2.0, 1.5], (40, 1)),
        yaw_rad=np.zeros(40),
        label=np.array(["vehicle"] * 40),
        score=np.linspace(0.3, 0.99, 40),
    )
    figure = overview(CLOUD, predicted=crowd)
    figure.draw_without_rendering()
    texts = [text for text in figure.axes[0].texts if text.get_text().startswith("vehicle")]
    assert "vehicle 0.99" in tags(figure)
    assert 1 < len(texts) < 20
    boxes = [text.get_window_extent() for text in texts]
    assert not [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)]
    apart = crowd.replace(
        centre_m=np.column_stack(
            [np.tile(np.linspace(10, 200, 8), 5), np.repeat(np.linspace(-40, 40, 5), 8), np.zeros(40)]
        )
    )
    assert len(tags(overview(CLOUD, predicted=apart))) == 40


def test_boxes_outside_the_window_have_no_tag() -> None:
    assert tags(overview(CLOUD, predicted=FOUND, window_m=(0.0, 40.0, -20.0, 20.0))) == {"vehicle 0.87"}


def test_predicted_boxes_bear_class_and_score_in_the_image() -> None:
    image = np.zeros((120, 200, 3), dtype=np.uint8)
    assert tags(camera_picture(image, CAMERA, predicted=FOUND)) == {"vehicle 0.87", "pedestrian 0.12"}
    behind = FOUND.replace(centre_m=FOUND.centre_m * [-1, 1, 1])
    assert tags(camera_picture(image, CAMERA, predicted=behind)) == set()


def test_a_report_s_camera_picture_has_the_points_and_the_colours_of_classes(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Cirrus, Figure 5: the cloud projected into the image, boxes in a colour a class."""
    from matplotlib.collections import LineCollection, PathCollection
    from matplotlib.colors import to_rgba

    from farfield.evaluation.record import FrameView
    from farfield.pages import evaluation_page
    from farfield.vocabulary.classes import CLASS_COLOURS

    drawn: list = []
    monkeypatch.setattr(evaluation_page, "figure_uri", lambda figure, *_, **__: drawn.append(figure) or "data:,")
    image = np.zeros((120, 200, 3), dtype=np.uint8)
    near = np.array([[10.0, 0, 0], [60, 10, 1], [-10, 0, 0]])
    points = ff.Frame.of(ff.Cloud(near), FOUND.plain(), images={"front": image}, cameras={"front": CAMERA})
    view = FrameView(frame=points, predictions={"lidar": FOUND})
    shown = evaluation_page.frame_pictures(view, evaluation_page.DrawingOptions(score_min=0.0))
    axes = drawn[-1].axes[0]
    (scattered,) = [each for each in axes.collections if isinstance(each, PathCollection)]
    pixels, _, visible = CAMERA.project(near)
    assert visible.tolist() == [True, True, False]
    np.testing.assert_allclose(scattered.get_offsets(), pixels[:2])
    assert scattered.get_array().tolist() == pytest.approx([10.0, np.hypot(60, 10)], rel=1e-6)
    lines = [each for each in axes.collections if isinstance(each, LineCollection)]
    colours = {tuple(colour) for each in lines for colour in each.get_colors()}
    assert colours == {to_rgba(CLASS_COLOURS[name]) for name in ("vehicle", "pedestrian")}
    assert {each.get_linestyle()[0][1] is None for each in lines} == {True, False}, "annotated solid, predicted dashed"
    assert "points of lidar" in shown[-1].caption
    assert "dashed" in shown[-1].caption


def test_show_draws_sure_boxes_and_says_so() -> None:
    frame = ff.Frame.of(CLOUD)
    figure = ff.show(frame, FOUND)
    assert tags(figure) == {"vehicle 0.87"}
    assert f"1 of 2 boxes: score {SHOWN_SCORE:g} or more" in figure.axes[0].get_title(loc="left")
    every = ff.show(frame, FOUND, shown_score=0.0)
    assert len(tags(every)) == 2
    assert "boxes: score" not in every.axes[0].get_title(loc="left"), "nothing is left out"


def test_every_picture_has_the_same_threshold() -> None:
    import inspect

    from farfield.cli import report
    from farfield.evaluation.report_data import annotated_objects
    from farfield.pages.evaluation_page import DrawingOptions, render_report, write_report
    from farfield.pages.film import FilmSettings

    assert FilmSettings().score == DrawingOptions().score_min == SHOWN_SCORE
    for function in (report.run, render_report, write_report, ff.show):
        assert inspect.signature(function).parameters["shown_score"].default == SHOWN_SCORE
    assert inspect.signature(annotated_objects).parameters["score_min"].default == SHOWN_SCORE


def test_predict_gives_what_the_api_gives_and_draws_on_camera_images(tmp_path, monkeypatch, capsys) -> None:
    pytest.importorskip("torch")
    from farfield.cli import main
    from farfield.datasets.memory import CloudFiles

    rng = np.random.default_rng(4)
    ground = np.column_stack([rng.uniform(3, 60, 4000), rng.uniform(-12, 12, 4000), rng.normal(-2, 0.03, 4000)])
    car = rng.uniform(-1, 1, (400, 3)) * [2.2, 0.9, 0.75] + [12.0, 0.0, -1.2]
    rows = np.column_stack([np.concatenate([ground, car]), np.full(4400, 0.3)]).astype(np.float32)
    (tmp_path / "own").mkdir()
    np.save(tmp_path / "own" / "0.npy", rows)
    monkeypatch.setattr(CloudFiles, "__getitem__", lambda self, index: _pictured(np.load(self.paths[index])))
    words = [
        "predict",
        "pointpillars-cirrus-sim",
        str(tmp_path / "own" / "0.npy"),
        "--precision",
        "fp32",
        "--device",
        "cpu",
    ]
    out, picture = tmp_path / "boxes.csv", tmp_path / "first.png"
    assert main([*words, "--out", str(out), "--picture", str(picture)]) == 0
    said = capsys.readouterr().out
    detector = ff.load_detector("pointpillars-cirrus-sim", precision="fp32", device="cpu")
    found = detector(ff.Frame.of(rows))
    assert detector.config.score_threshold == 0.05
    np.testing.assert_allclose(ff.Boxes.from_csv(out).score, found.score, rtol=1e-5)  # written with six digits
    assert "score 0.05 or more" in said
    assert picture.is_file()
    drawn = np.asarray(Image.open(tmp_path / "first-front.png"))
    assert drawn[..., :3].max() > 100, "boxes are drawn on the black image"
    assert "first-front.png" in said
    assert "rear" in said
    assert "no calibration" in said


def _pictured(rows: np.ndarray) -> ff.Frame:
    image = np.zeros((120, 200, 3), dtype=np.uint8)
    return ff.Frame.of(rows, images={"front": image, "rear": image}, cameras={"front": CAMERA})
