"""What a notebook shows of a frame, a cloud, boxes, a detector and a result: one line of words and a picture."""

import base64
import io
import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

import farfield as ff


def make_boxes(rng: np.random.Generator, x_m: list[float], label: str = "vehicle") -> ff.Boxes:
    centre_m = np.column_stack([x_m, rng.uniform(-20, 20, len(x_m)), np.full(len(x_m), -1.0)])
    size_m = np.tile([4.5, 1.9, 1.6], (len(x_m), 1))
    return ff.Boxes(centre_m=centre_m, size_m=size_m, yaw_rad=rng.uniform(-3, 3, len(x_m)), label=label)


def make_cloud(rng: np.random.Generator, n: int) -> ff.Cloud:
    return ff.Cloud(rng.uniform([1, -50, -2], [250, 50, 3], (n, 3)).astype(np.float32))


def shown(thing: Any) -> tuple[str, np.ndarray]:
    """The words beside the picture, and the picture, shape (height, width, 3)."""
    html = thing._repr_html_()
    (data,) = re.findall(r'<img[^>]* src="data:image/png;base64,([^"]+)"', html)
    assert re.search(r'<img[^>]* alt="[^"]{10,}"', html)
    return re.sub(r"<[^>]+>", " ", html), np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def is_drawn(picture: np.ndarray) -> bool:
    """Whether a picture is large enough and not empty."""
    return min(picture.shape[:2]) > 150 and len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def has_colour(picture: np.ndarray, colour: str) -> bool:
    wanted = np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)])
    return bool((np.abs(picture.astype(int) - wanted).sum(axis=2) < 12).any())


def test_a_cloud_boxes_and_a_frame_draw_themselves(rng: np.random.Generator) -> None:
    from farfield.figures.style import ANNOTATED, PREDICTED

    cloud, boxes = make_cloud(rng, 500), make_boxes(rng, [20.0, 60.0])
    scored = boxes.replace(score=np.array([0.9, 0.2]))
    words, picture = shown(cloud)
    assert "500 points" in words
    assert is_drawn(picture)
    words, picture = shown(scored)
    assert "0.90" in words, "a table with the score of each box"
    assert has_colour(picture, PREDICTED)
    words, picture = shown(ff.Frame.of(cloud, boxes))
    assert "memory/0" in words
    assert has_colour(picture, ANNOTATED)


def test_nothing_to_draw_is_said_in_words() -> None:
    for thing in (ff.Boxes.empty(), ff.Cloud(np.zeros((0, 3))), ff.Frame(sequence="a", frame_id="<b>")):
        html = thing._repr_html_()
        assert "<img" not in html
        assert "<b>" not in html
        assert type(thing).__name__ in html


def test_names_of_classes_cannot_write_html(rng: np.random.Generator) -> None:
    html = make_boxes(rng, [20.0], label="<script>")._repr_html_()
    assert "<script" not in html
    assert "&lt;script&gt;" in html


def test_a_result_draws_its_curves(rng: np.random.Generator) -> None:
    boxes = make_boxes(rng, [20.0, 60.0])
    result = ff.evaluate(_same, [ff.Frame.of(make_cloud(rng, 200), boxes)])
    words, picture = shown(result)
    assert "dds" in words
    assert is_drawn(picture)
    assert "\n" not in repr(result)


def _same(frame: ff.Frame) -> ff.Boxes:
    assert frame.boxes is not None
    return frame.boxes.plain().replace(score=np.ones(len(frame.boxes)))


@pytest.mark.parametrize("name", ["pointpillars", "pointrcnn", "sparsecentre"])
def test_a_detector_draws_where_it_looks(name: str) -> None:
    pytest.importorskip("torch")
    from farfield.detectors import DETECTORS, build_detector
    from farfield.detectors.runtime import Detector

    config = DETECTORS[name].config_class(grid={"range_m": 48.0, "half_width_m": 16.0})
    detector = Detector(build_detector(config), precision="fp32")
    words, picture = shown(detector)
    assert "48 m" in words
    assert "vehicle" in words
    assert is_drawn(picture)
    assert "\n" not in repr(detector)
