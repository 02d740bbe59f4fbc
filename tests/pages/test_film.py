"""Films of drives: what stands where, trails, resuming."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.folder import write_boxes
from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.pages import film
from farfield.pages.film import (
    SIZE,
    DrawnBoxes,
    FilmSettings,
    FilmWork,
    PanelView,
    cloud_panel,
    drive_named,
    make_film,
    panel_rectangles,
    panels_of,
    rate_of,
    track_colour,
)

FRAMES = 5


def boxes(x: float) -> Boxes:
    return Boxes(
        centre_m=np.array([[x, 5.0, 0.0]]),
        size_m=np.array([[4.0, 2.0, 1.6]]),
        yaw_rad=np.zeros(1),
        label=np.array(["vehicle"]),
        track_id=np.array([3], dtype=np.int64),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    root = tmp_path / "sweeps"
    root.mkdir()
    for number in range(FRAMES):
        points = rng.uniform([-50, -50, -2, 0], [90, 50, 3, 1], (3000, 4)).astype(np.float32)
        np.save(root / f"{number:04d}.npy", points)
        write_boxes(root / f"{number:04d}.json", boxes(10.0 + 4 * number))
    return root


def test_a_film_has_a_picture_a_frame_and_leaves_nothing_beside_it(folder: Path, tmp_path: Path):
    out = tmp_path / "out" / "drive.gif"
    out.parent.mkdir()
    assert make_film(out, open_dataset(folder)) == FRAMES
    with Image.open(out) as shown:
        assert (shown.n_frames, shown.size) == (FRAMES, SIZE)
    assert [path.name for path in out.parent.iterdir()] == ["drive.gif"]


def test_an_mp4_has_the_drives_rate(folder: Path, tmp_path: Path):
    pytest.importorskip("av")
    from farfield.files.videos import read_film

    assert make_film(tmp_path / "drive.mp4", open_dataset(folder), settings=FilmSettings(rate_hz=5)) == FRAMES
    shown = read_film(tmp_path / "drive.mp4")
    assert (len(shown), shown.width, shown.height) == (FRAMES, *SIZE)
    assert np.allclose(np.diff(shown.times_s), 0.2, atol=1e-3)


def test_an_interrupted_film_goes_on_where_it_stopped(folder: Path, tmp_path: Path, monkeypatch):
    data, drawn, real = open_dataset(folder), list[str](), film.film_picture

    def stops(frame: Frame, *arguments, **more):
        if len(drawn) == 3:
            raise KeyboardInterrupt
        drawn.append(frame.frame_id)
        return real(frame, *arguments, **more)

    monkeypatch.setattr(film, "film_picture", stops)
    with pytest.raises(KeyboardInterrupt):
        make_film(tmp_path / "a.gif", data)
    assert not (tmp_path / "a.gif").exists()

    def goes_on(frame: Frame, *arguments, **more):
        drawn.append(frame.frame_id)
        return real(frame, *arguments, **more)

    monkeypatch.setattr(film, "film_picture", goes_on)
    make_film(tmp_path / "a.gif", data)
    assert sorted(drawn) == sorted(data.frame_ids)
    make_film(tmp_path / "b.gif", data)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_boxes_lie_where_they_are_and_keep_their_tracks_colour():
    view = PanelView(400, 400, 100.0)
    cloud = Cloud(np.array([[50.0, 20.0, 0.0]], dtype=np.float32), np.ones(1, dtype=np.float32))
    trail = np.array([[60.0, -20.0, 0.0], [30.0, -20.0, 0.0]])
    panel = np.asarray(cloud_panel(cloud, [DrawnBoxes(boxes(10.0), False, {3: trail})], view))
    column, row = view.pixels(np.array([[50.0, 20.0]]))[0].astype(int)
    assert panel[row, column].tolist() != panel[5, 5].tolist()
    colour = [int(track_colour(3)[start : start + 2], 16) for start in (1, 3, 5)]
    rows, columns = np.nonzero((panel == colour).all(axis=2))
    face = view.pixels(np.array([[12.0, 5.0], [8.0, 5.0], [45.0, -20.0]]))
    for column, row in face:
        assert (np.hypot(rows - row, columns - column) <= 1.5).any()
    assert columns[rows < 180].max() < 200 + 25 * view.scale


class Passing(Dataset):
    """A sensor that drives past an object that stands."""

    name = "passing"

    def __init__(self) -> None:
        self.root, self.sequences = Path(), ("a",) * FRAMES
        self.frame_ids = tuple(map(str, range(FRAMES)))

    def frame(self, index: int) -> Frame:
        cloud = Cloud(np.ones((9, 3), np.float32), np.ones(9, np.float32))
        given = Frame.of(cloud, Annotation(boxes=boxes(30.0 - 5 * index)))
        return replace(given, sequence="a", frame_id=str(index))

    def _times_of(self, indices: np.ndarray) -> np.ndarray:
        return indices * 50_000_000

    def _poses_of(self, indices: np.ndarray) -> np.ndarray:
        poses = np.tile(np.eye(4), (len(indices), 1, 1))
        poses[:, 0, 3] = 5.0 * indices
        return poses

    def files(self, index: int):
        del index
        return ()


def test_trails_stand_in_the_frame_that_is_shown_and_rates_come_from_times(tmp_path: Path):
    data = Passing()
    drive = drive_named(data, "a")
    work = FilmWork(data, drive, tmp_path, panels_of(data, drive))
    drawn = work._drawn(4, False)
    assert drawn is not None
    assert np.allclose(drawn.trails[3], [10.0, 5.0, 0.0])
    assert len(drawn.trails[3]) == FRAMES
    assert rate_of(drive, FilmSettings()) == 20


def test_panels_do_not_overlap():
    for count in range(1, 8):
        taken = np.zeros(SIZE[::-1], dtype=int)
        for left, top, width, height in panel_rectangles(count):
            assert left + width <= SIZE[0]
            assert top + height <= SIZE[1]
            taken[top : top + height, left : left + width] += 1
        assert taken.max() == 1


def test_what_cannot_be_made_is_refused_before_anything_is_drawn(folder: Path, tmp_path: Path):
    with pytest.raises(ConfigError, match="nothere"):
        make_film(tmp_path / "a.gif", open_dataset(folder), drive="nothere")
    with pytest.raises(ConfigError, match="ending"):
        make_film(tmp_path / "a.txt", open_dataset(folder))
    assert [path.name for path in tmp_path.iterdir()] == ["sweeps"]
