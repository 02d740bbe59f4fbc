"""Open Sweeps: what ships, its licences, its boxes, places that are held apart."""

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import farfield as ff
from farfield.datasets.open_sweeps import DIRECTIONS, INDEX, PASSES, ROOT, STEP_M, OpenSweeps, pack_sweep, read_sweep
from farfield.errors import DatasetError, FarfieldError, FileFormatError
from farfield.geometry.boxes import count_points_in_boxes

CAPTURES = {"os-0-128": "OS-0-128-U1_v2.3.0_1024x10", "os-1-128": "OS-1-128_v2.3.0_1024x10_lb_n3"}


def test_what_ships_opens_by_its_name_with_licences_and_a_card() -> None:
    data = ff.open_dataset("open-sweeps")
    assert data.name == "open_sweeps"
    assert len(data) == 12
    assert data.protocol == "open-sweeps"
    files = [path for path in ROOT.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 5e6
    for entry in json.loads((ROOT / INDEX).read_text())["open_sweeps"]:
        licence, _, file = entry["licence"].partition(", ")
        assert licence.split("-")[0] in (ROOT / file).read_text().replace("Redistribution", "BSD"), file
    card = (ROOT / "README.md").read_text()
    assert "AI model" in card, "the card says who annotated"


def test_every_sweep_is_seen_ahead_and_turned_with_the_same_objects() -> None:
    data = OpenSweeps()
    for index in range(0, len(data), len(DIRECTIONS)):
        ahead, back = data[index], data[index + 1]
        assert back.frame_id == f"{ahead.frame_id}-back"
        np.testing.assert_allclose(
            back.cloud("lidar").points_m[:, :2], -ahead.cloud("lidar").points_m[:, :2], atol=1e-3
        )
        boxes = ahead.boxes
        assert boxes is not None
        np.testing.assert_allclose(back.boxes.centre_m[:, :2], -boxes.centre_m[:, :2], atol=1e-9)
        counts = count_points_in_boxes(ahead.cloud("lidar").points_m, boxes)
        vehicles = np.isin(boxes.label, ["vehicle", "large_vehicle"])
        assert (counts[vehicles] >= 5).mean() > 0.95, "boxes stand on points"
        assert boxes.range_m.max() < 70


def test_places_are_parts_that_share_no_frame() -> None:
    data = OpenSweeps()
    assert data.places == ("avenue", "corner", "junction")
    for place in data.places:
        alone, others = data.split(place), data.split(f"not-{place}")
        assert set(alone.sequences) == {place}
        assert not set(alone.keys) & set(others.keys)
        assert len(alone) + len(others) == len(data)
    with pytest.raises(FarfieldError, match="expected a split, one of avenue"):
        data.split("town")


def test_coordinates_are_those_measured_to_half_a_step(shared_open: Path) -> None:
    captures = ff.open_dataset(shared_open / "ouster")
    data = OpenSweeps()
    for name, capture in CAPTURES.items():
        measured = captures[captures.keys.index((capture, "000000"))].cloud("lidar")
        order = np.lexsort((measured.extra["offset_ns"], measured.extra["ring"]))
        cloud = data[data.frame_ids.index(name)].cloud("lidar")
        assert np.abs(cloud.points_m - measured.points_m[order]).max() <= STEP_M / 2 + 1e-6
        np.testing.assert_allclose(cloud.column("intensity"), measured.intensity[order], atol=1e-6)
        np.testing.assert_array_equal(cloud.extra["ring"], measured.extra["ring"][order])


def test_the_passes_agree_as_the_card_says() -> None:
    from farfield.datasets.folder import read_boxes
    from farfield.geometry.iou import pairwise_iou

    overlaps = []
    for sweep in OpenSweeps().sweeps:
        first, second = (read_boxes(ROOT / "labels" / name / f"{sweep.name}.json") for name in PASSES)
        first, second = (boxes[np.isin(boxes.label, ["vehicle", "large_vehicle"])] for boxes in (first, second))
        overlaps += pairwise_iou(first, second, kind="bev").max(axis=1).tolist()
    assert np.median(overlaps) > 0.7
    assert np.mean(np.array(overlaps) > 0.3) > 0.9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one small sweep."""
    entry = {"name": "one", "location": "here", "sensor": "any", "points": 2, "columns": ["reflectivity"]}
    entry |= {"source": "test", "licence": "none"}
    (tmp_path / INDEX).write_text(json.dumps({"open_sweeps": [entry]}))
    points = np.array([[1.0, 2.0, 3.0], [-200.0, 4.0, 5.0]], dtype=np.float32)
    (tmp_path / "one.sweep").write_bytes(pack_sweep(points, [np.array([7, 200])]))
    return tmp_path


def test_a_sweep_comes_back_as_it_was_packed(folder: Path) -> None:
    data = ff.open_dataset(folder)
    cloud = data[0].cloud("lidar")
    np.testing.assert_allclose(cloud.points_m, [[1, 2, 3], [-200, 4, 5]], atol=STEP_M / 2)
    np.testing.assert_allclose(cloud.column("intensity"), [7 / 255, 200 / 255], atol=1e-6)
    assert data[0].annotation is None
    with pytest.raises(ValueError, match="within 256 m"):
        pack_sweep(np.full((1, 3), 300.0, dtype=np.float32), [])


@pytest.mark.parametrize(
    "packed",
    [b"", b"no stream", zlib.compress(b"short"), zlib.compress(bytes(10_000_000)), zlib.compress(bytes(16))[:-3]],
    ids=["empty", "no stream", "too short", "a bomb", "cut"],
)
def test_a_damaged_sweep_is_refused_by_its_name(folder: Path, packed: bytes) -> None:
    (folder / "one.sweep").write_bytes(packed)
    with pytest.raises(FileFormatError, match=r"one\.sweep"):
        ff.open_dataset(folder)[0].cloud("lidar").points_m  # noqa: B018


@pytest.mark.parametrize("text", ["[]", '{"open_sweeps": []}', '{"open_sweeps": [{"name": "../x"}]}', "{"])
def test_a_damaged_index_is_refused_by_its_name(folder: Path, text: str) -> None:
    (folder / INDEX).write_text(text)
    with pytest.raises(FarfieldError, match=INDEX):
        ff.open_dataset(folder)


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({"columns": ["ring"] * 3}, 1),
        ({"columns": ["ring", "ring"]}, 1),
        ({"location": "not-here"}, 1),
        ({}, 2),
    ],
    ids=["many columns", "a column twice", "a place called as all others", "a name twice"],
)
def test_an_index_of_repeated_or_ambiguous_names_is_refused(folder: Path, changes: dict[str, Any], count: int) -> None:
    entry = json.loads((folder / INDEX).read_text())["open_sweeps"][0] | changes
    (folder / INDEX).write_text(json.dumps({"open_sweeps": [entry] * count}))
    with pytest.raises(FileFormatError, match=INDEX):
        OpenSweeps(folder)


def test_a_folder_of_that_name_comes_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent)
    folder.rename(folder.parent / "open-sweeps")
    assert ff.open_dataset("open-sweeps").sequences == ("here", "here")
    with pytest.raises(DatasetError, match="expected a data set's folder"):
        ff.open_dataset("open-sweepz")


def test_what_a_sweep_lacks_is_not_read(folder: Path) -> None:
    sweep = OpenSweeps(folder).sweeps[0].model_copy(update={"points": 3})
    with pytest.raises(FileFormatError, match="unpacked"):
        read_sweep(folder / "one.sweep", sweep)
