"""Detections of several weathers as those of one data set, their table and their picture."""

import dataclasses
import io
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.weathers import key_in, merge_weathers, weather_table
from farfield.figures.radar import weathers_picture
from farfield.figures.style import figure_bytes
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame
from farfield.metrics.detections import Detections
from farfield.pages.evaluation_page import render_report

KEYS = (("1", "00001_00001"), ("2", "00001_00001"))


def boxes(x_m: float, score: float | None = None) -> Boxes:
    return Boxes(
        centre_m=np.array([[x_m, 0.0, 0.0]]),
        size_m=np.array([[4.2, 1.9, 1.6]]),
        yaw_rad=np.zeros(1),
        label=np.array(["vehicle"]),
        score=None if score is None else np.array([score]),
    )


def found(weather: str, off_m: float, fingerprint: str = "") -> Detections:
    """A vehicle a frame; the prediction is off by so many metres."""
    return Detections(
        boxes={key: boxes(30.0 + off_m, 0.9) for key in KEYS},
        annotations={key: Annotation(boxes=boxes(30.0)) for key in KEYS},
        conditions={key: {"weather": weather} for key in KEYS},
        reference="radar",
        cloud="radar",
        classes=("vehicle",),
        detector="some",
        data=weather,
        fingerprint=fingerprint,
        facts={"label_version": "v2.1"},
        seen_in_training="not found, it learnt from other data",
        notes=("the same note",),
    )


def scored(parts: dict[str, Detections]) -> dict[str, Any]:
    return merge_weathers(parts, "both").score("kradar", region="narrow", classes=("vehicle",)).to_json()


def test_drives_are_told_apart_by_weather() -> None:
    joined = merge_weathers({"normal": found("normal", 0.0, "a"), "heavy_snow": found("heavy_snow", 20.0, "b")}, "both")
    assert set(joined.boxes) == set(joined.annotations) == set(joined.conditions)
    assert len(joined.boxes) == 4
    assert key_in("heavy_snow", KEYS[0]) == ("1 in heavy snow", "00001_00001")
    assert joined.boxes["1 in heavy snow", "00001_00001"].centre_m[0, 0] == 50.0
    mixed, same = joined.notes
    assert "mix 2 frames in normal and 2 frames in heavy snow" in mixed
    assert same == "the same note"
    assert merge_weathers({"normal": found("normal", 0.0)}, "one").notes == ("the same note",)
    assert joined.seen_in_training == "not found, it learnt from other data"
    other = merge_weathers({"normal": found("normal", 0.0, "a"), "heavy_snow": found("heavy_snow", 20.0, "c")}, "both")
    assert joined.fingerprint != other.fingerprint != ""


def test_each_weather_has_its_own_figure_and_the_table_names_its_subject() -> None:
    result = scored({"normal": found("normal", 0.0), "sleet": found("sleet", 20.0)})
    text = weather_table({"radar": result}, ("normal", "sleet"))
    head, _, row, counts, *rest = text.splitlines()
    assert head.split()[-2:] == ["normal", "sleet"]
    assert row.split() == ["some", "(radar)", "100.0", "[100.0,", "100.0]", "0.0", "[0.0,", "0.0]"]
    assert counts.split() == ["annotated", "vehicles", *(["2", "in", "2", "frames"] * 2)]
    about = " ".join(rest)
    for word in ("some on both", "cloud radar", "4 objects in 4", "kradar", "not found, it learnt from other data"):
        assert word in about, word


def test_a_weather_without_frames_has_no_figure() -> None:
    result = scored({"normal": found("normal", 0.0)})
    row = weather_table({"radar": result}, ("normal", "fog")).splitlines()[2]
    assert row.split()[-1] == "-"


def view(weather: str, clouds: tuple[str, ...] = ("radar", "os2-64")) -> FrameView:
    rng = np.random.default_rng(1)
    points = rng.uniform((0, -10, -1), (70, 10, 1), size=(500, 3)).astype(np.float32)
    frame = Frame(
        sequence="1",
        frame_id="1",
        reference="radar",
        clouds={name: Cloud(points) for name in clouds},
        conditions={"weather": weather},
        load_annotation=Constant(Annotation(boxes=boxes(30.0))),
    )
    power = np.full((400, 250), np.nan, dtype=np.float32)
    power[160:240, :180] = rng.normal(size=(80, 180))
    found_by = {name: boxes(31.0 + 12.0 * place, 0.8) for place, name in enumerate(clouds)}
    return FrameView(frame=frame, predictions=found_by, title=weather, radar_db=power)


def pixels(views: list[FrameView]) -> np.ndarray:
    from PIL import Image

    figure = weathers_picture(views, radar="radar", lidar="os2-64")
    return np.asarray(Image.open(io.BytesIO(figure_bytes(figure, "png", dpi=110))).convert("RGB")).astype(int)


def test_the_picture_has_a_column_a_weather_and_the_boxes_of_both() -> None:
    one, two = pixels([view("normal")]), pixels([view("normal"), view("sleet")])
    assert two.shape[1] > 1.8 * one.shape[1]
    for colour in ((0xFF, 0xD4, 0x3B), (0xFF, 0x8C, 0xC6), (0xC2, 0x25, 0x5C), (0x0B, 0x6E, 0x99)):
        near = np.abs(two - colour).max(axis=2) < 24
        half = two.shape[1] // 2
        assert near[:, :half].any(), colour
        assert near[:, half:].any(), colour


def test_a_caption_counts_what_the_score_counts() -> None:
    """Boxes beside the corridor are drawn, but neither found nor missed."""
    result = scored({"normal": found("normal", 0.0)})
    aside = boxes(30.0).replace(centre_m=np.array([[30.0, 9.0, 0.0]]))
    both = Boxes.concatenate([boxes(30.0), aside])
    frame = dataclasses.replace(view("normal").frame, load_annotation=Constant(Annotation(boxes=both)))
    seen = FrameView(frame=frame, predictions={"radar": boxes(30.0, 0.8)}, title="normal")
    page = render_report(Evaluation(results={"radar": result}, frames=[seen]))
    assert "1 of 1 annotated object in the region that counts found" in page


def test_a_view_that_lacks_a_sensor_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected the radar's power and boxes of radar and os2-64"):
        weathers_picture([view("normal", ("radar",))], radar="radar", lidar="os2-64")
