"""Pictures as they are sent: their own bytes where those are few, a JPEG made once where they are many."""

import io
from functools import partial

import numpy as np
import pytest
from PIL import Image

from farfield.datasets.base import Dataset
from farfield.files.images import read_image
from farfield.frame import Frame, Lazy
from farfield.studio.showing import layers
from farfield.studio.showing.layers import picture
from farfield.studio.showing.opened import OpenedDataset


def road_scene(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Smooth grounds with a sensor's noise, which a PNG must keep and a JPEG need not."""
    rows, columns = np.mgrid[:height, :width]
    smooth = 90 + 60 * np.sin(columns / 90) + 40 * np.cos(rows / 60)
    return np.clip(smooth[..., None] + rng.normal(0, 3, (height, width, 3)), 0, 255).astype(np.uint8)


def frame_of(path) -> Frame:
    images = Lazy({"front": partial(read_image, path)})
    return Frame(sequence="a", frame_id="0", images=images, reference="lidar")


@pytest.fixture
def large(tmp_path, rng):
    path = tmp_path / "large.png"
    Image.fromarray(road_scene(rng, 370, 1224)).save(path)
    assert path.stat().st_size > 500_000
    return path


def test_a_large_png_is_sent_as_jpeg(large):
    data, kind = picture(frame_of(large), "front")
    assert kind == "image/jpeg"
    assert len(data) < large.stat().st_size / 4
    apart = np.asarray(Image.open(io.BytesIO(data))).astype(float) - read_image(large)
    assert np.abs(apart).mean() < 4


def test_every_pixel_is_sent_where_it_is_asked_for(large):
    assert picture(frame_of(large), "front", exact=True) == (large.read_bytes(), "image/png")


def test_a_small_png_and_one_that_a_jpeg_would_not_shorten_stay(tmp_path, rng, monkeypatch):
    small, drawn = tmp_path / "small.png", tmp_path / "drawn.png"
    Image.fromarray(road_scene(rng, 60, 80)).save(small)
    assert picture(frame_of(small), "front") == (small.read_bytes(), "image/png")
    lines = np.zeros((300, 400, 3), dtype=np.uint8)
    lines[::3, ::2] = 255
    Image.fromarray(lines).save(drawn)
    monkeypatch.setattr(layers, "_LARGE_BYTES", 10)
    assert picture(frame_of(drawn), "front") == (drawn.read_bytes(), "image/png")
    assert picture(frame_of(small), "front")[1] == "image/jpeg"


def test_a_picture_is_encoded_once(large, monkeypatch):
    made = []
    encode = layers.as_jpeg
    monkeypatch.setattr(layers, "as_jpeg", lambda image: made.append(1) or encode(image))
    opened = OpenedDataset(_One(frame_of(large)))
    first, again, exact = opened.picture(0, 0), opened.picture(0, 0), opened.picture(0, 0, exact=True)
    assert first is again
    assert len(made) == 1
    assert (first.kind, exact.kind) == ("image/jpeg", "image/png")
    assert first.tag != exact.tag


class _One(Dataset):
    """A data set of one frame."""

    name = "one"

    def __init__(self, frame: Frame) -> None:
        self.only, self.root = frame, frame.images.loader("front").args[0].parent
        self.sequences, self.frame_ids = ("a",), ("0",)

    def frame(self, index: int) -> Frame:
        return self.only

    def files(self, index: int) -> list:
        return []
