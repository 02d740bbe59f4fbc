"""Which pictures are found, in which order, and the partner in the other eye's picture."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError, DatasetError
from farfield.privacy.image_boxes import ImageBoxes
from farfield.privacy.linking import find_partners
from farfield.privacy.sources import find_sources, find_stereo_pairs


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def test_pictures_come_by_folder_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    touched(tmp_path, "b/frame_10.png", "b/frame_9.png", "a/x.JPG", "a/notes.txt", ".hidden/y.png", "a/.z.png")
    one, other = find_sources(tmp_path).folders
    assert [file.as_posix() for file in one.files] == ["a/x.JPG"]
    assert [file.name for file in other.files] == ["frame_9.png", "frame_10.png"]
    np.testing.assert_allclose(other.times_s, [0, 0.1])
    assert not other.stamped


def test_names_of_nanoseconds_are_stamps(tmp_path: Path) -> None:
    touched(tmp_path, "1567000000000000000.jpg", "1567000000250000000.jpg")
    (series,) = find_sources(tmp_path).folders
    assert series.stamped
    np.testing.assert_allclose(series.times_s, [0, 0.25])


def test_films_stand_beside_pictures(tmp_path: Path) -> None:
    touched(tmp_path, "b/a.mp4", "b/0.png", "c.MKV", ".x.mp4")
    sources = find_sources(tmp_path)
    assert [file.as_posix() for file in sources.films] == ["c.MKV", "b/a.mp4"]
    assert [series.name for series in sources.folders] == ["b"]
    alone = find_sources(tmp_path / "b" / "a.mp4")
    assert (alone.root, alone.films, alone.folders) == (tmp_path / "b", (Path("a.mp4"),), ())


def test_links_are_not_followed(tmp_path: Path) -> None:
    outside = touched(tmp_path / "outside", "secret.png")
    inside = touched(tmp_path / "inside", "own.png")
    (inside / "link.png").symlink_to(outside / "secret.png")
    (inside / "folder").symlink_to(outside)
    assert [file.name for series in find_sources(inside).folders for file in series.files] == ["own.png"]
    (picture,) = find_sources(inside / "own.png").folders
    assert picture.files == (Path("own.png"),)
    with pytest.raises(DatasetError, match="expected pictures"):
        find_sources(touched(tmp_path / "empty", "notes.txt"))


def test_eyes_are_paired_by_their_folders(tmp_path: Path) -> None:
    touched(
        tmp_path,
        *(f"drive/{eye}/data/0.png" for eye in ("image_02", "image_03", "image_00")),
        "left/0.png",
        "right/0.png",
    )
    folders = find_sources(tmp_path).folders
    names = [series.name for series in folders]
    assert [(names[a], names[b]) for a, b in find_stereo_pairs(folders)] == [
        ("drive/image_02/data", "drive/image_03/data")
    ]
    assert [(names[a], names[b]) for a, b in find_stereo_pairs(folders, [("left", "right")])] == [("left", "right")]
    with pytest.raises(ConfigError, match="two different folders"):
        find_stereo_pairs(folders, [("left", "left")])


def test_the_partner_is_found_by_its_looks(rng) -> None:
    cv2 = pytest.importorskip("cv2")
    left = cv2.GaussianBlur(rng.integers(0, 256, (120, 200, 3), dtype=np.uint8), (0, 0), 2)
    right = np.roll(left, -17, axis=1)
    box = np.array([[80.0, 40.0, 110.0, 75.0]])
    hits = ImageBoxes.of_kind("face", box, np.array([0.9]))
    found = find_partners(left, hits, right, ImageBoxes())
    np.testing.assert_allclose(found.boxes.box_px, box - [17, 0, 17, 0], atol=1)
    assert not len(found.lost)
    known = find_partners(left, hits, right, ImageBoxes.of_kind("face", box - [16, 0, 16, 0], np.array([0.8])))
    assert not len(known.boxes)
    assert not len(known.lost)
    hidden = right.copy()
    hidden[:, 55:105] = 90
    assert len(find_partners(left, hits, hidden, ImageBoxes()).lost) == 1
    assert len(find_partners(left, ImageBoxes(), right, ImageBoxes()).boxes) == 0
