"""RADIATE in its real layout: places and headings by hand, in the conventions of its documentation."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from trees import SECONDS, write_sequence

from farfield.datasets import open_dataset, recognise
from farfield.datasets.radiate import CELL_M, Radiate, find_sequences
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.radiate import read_times, read_tracks
from farfield.inspection.doctor import examine


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "fog_6_0")


def test_boxes_stand_where_the_picture_shows_them(sequence):
    data = open_dataset(sequence.parent)
    assert data.name == recognise(sequence) == "radiate"
    assert data.keys == (("fog_6_0", "000001"), ("fog_6_0", "000002"))
    first, second = data[0].boxes, data[1].boxes
    np.testing.assert_allclose(first.centre_m[0, :2], [40 * CELL_M, -20 * CELL_M], atol=1e-9)
    np.testing.assert_allclose(first.size_m[0, :2], [30 * CELL_M, 12 * CELL_M])
    np.testing.assert_allclose(np.cos(first.yaw_rad), -1)
    assert (first.label.tolist(), first.track_id.tolist()) == (["large_vehicle"], [1])
    np.testing.assert_allclose(second.centre_m[0, :2], [-60 * CELL_M, 10 * CELL_M], atol=1e-9)
    heading = np.array([np.cos(second.yaw_rad[0]), np.sin(second.yaw_rad[0])])
    np.testing.assert_allclose(heading, [np.cos(np.radians(86)), -np.sin(np.radians(86))], atol=1e-9)
    assert second.centre_m[0, 2] - second.size_m[0, 2] / 2 == pytest.approx(-1.8)
    assert Radiate(sequence, classes="radiate")[1].boxes.label.tolist() == ["van"]


def test_the_doctor_finds_it_fit_and_asks_for_no_file_that_it_would_not_read(sequence):
    report = examine(open_dataset(sequence.parent))
    assert not report.failed
    (calibration,) = (finding for finding in report.findings if finding.topic == "calibration")
    assert calibration.severity == "warn"
    assert "calibration.yaml" not in calibration.fix


def test_the_radars_cells_go_clockwise_from_forward(sequence):
    frame = open_dataset(sequence)[0]
    assert frame.reference == "radar"
    assert (frame.radar["polar"].shape, frame.radar["cartesian"].shape) == ((576, 400), (1152, 1152))
    cloud = frame.clouds["radar"]
    half = np.radians(0.45)
    expected = [
        [100 * np.cos(half), -100 * np.sin(half)],
        [200 * np.sin(half), -200 * np.cos(half)],
        [300 * np.sin(half), 300 * np.cos(half)],
    ]
    np.testing.assert_allclose(cloud.points_m[:, :2], np.array(expected) * CELL_M, atol=1e-4)
    np.testing.assert_allclose(cloud.extra["strength"], [1.0, 0.4, 0.2])
    row, column = np.argwhere(frame.radar["cartesian"] == 1)[0]
    ahead_m, left_m = (575.5 - row) * CELL_M, (575.5 - column) * CELL_M
    np.testing.assert_allclose([ahead_m, left_m], cloud.points_m[0, :2], atol=CELL_M)


@pytest.mark.parametrize(("share", "count"), [(1, 576 * 400), (1.5 / (576 * 400), 1), (2 / (576 * 400), 2), (0.5, 3)])
def test_the_share_bounds_the_number_of_points(sequence, share, count):
    assert len(open_dataset(sequence, radar_share=share)[0].clouds["radar"]) == count


def test_the_lidar_is_the_sweep_of_the_moment_in_the_radars_axes(sequence):
    data = open_dataset(sequence)
    frame = data[0]
    # 0.25 s before the radar's stamp is second .0; sweep 7's ".10000000" are 10,000,000 ns
    assert frame.sensors["lidar"].time_ns == SECONDS * 10**9 + 10_000_000
    assert frame.time_ns == SECONDS * 10**9 + 250_000_000
    expected = [[10 - 0.120102, -3 - 0.6003, -1 + 0.250012], [-20 - 0.120102, 4 - 0.6003, 2 + 0.250012]]
    np.testing.assert_allclose(frame.clouds["lidar"].points_m, expected, atol=1e-5)
    np.testing.assert_allclose(frame.clouds["lidar"].intensity, [0.2, 1.0])
    assert frame.clouds["lidar"].extra["ring"].tolist() == [0, 31]
    assert "zed_left" not in frame.images
    assert list(data[1].clouds) == ["radar"]
    assert data[1].images["zed_left"].shape == (4, 6, 3)
    assert frame.conditions == {"weather": "fog"}
    assert all(path.is_file() for index in range(2) for path in data.files(index))


def test_parts_that_are_missing_are_absent(sequence):
    for name in ("meta.json", "velo_lidar.txt", "Navtech_Cartesian.txt", "annotations/annotations.json"):
        (sequence / name).unlink()
    frame = open_dataset(sequence)[0]
    assert (frame.boxes, list(frame.clouds), frame.conditions) == (None, ["radar"], {})
    (sequence / "Navtech_Polar.txt").unlink()
    assert open_dataset(sequence)[0].time_ns is None
    for path in (sequence / "Navtech_Polar").glob("*.png"):
        path.unlink()
    assert list(open_dataset(sequence)[0].radar) == ["cartesian"]
    with pytest.raises(DatasetError, match="Navtech_Polar"):
        Radiate(sequence / "annotations")
    assert find_sequences(sequence / "annotations") == []


def test_a_picture_of_another_size_is_named(sequence):
    Image.fromarray(np.zeros((576, 399), np.uint8)).save(sequence / "Navtech_Polar" / "000001.png")
    with pytest.raises(DatasetError, match="576 rows and 400 columns"):
        open_dataset(sequence)[0].radar["polar"]


@pytest.mark.parametrize("options", [{"radar_share": 0}, {"radar_share": 1.1}, {"classes": "kitti"}])
def test_an_option_out_of_range_is_named(sequence, options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        open_dataset(sequence, **options)


@pytest.mark.parametrize(
    "line", ["Frame: 1 Time: x.1", "Frame: 1 Time: 1.1234567890", "1 1.0", "Frame: -1 Time: 1.0", "Frame: 1 Time: ."]
)
def test_a_damaged_time_list_is_named(tmp_path, line):
    (tmp_path / "t.txt").write_text(f"Frame: 000001 Time: 1574859771.1\n\n{line}\n")
    with pytest.raises(FileFormatError, match="line 3"):
        read_times(tmp_path / "t.txt")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "list"),
        ("[1]", "object 0"),
        ('[{"id": true, "class_name": "car", "bboxes": []}]', "object 0"),
        ('[{"id": 1, "class_name": "car", "bboxes": [[], {"position": [1, 2, 3]}]}]', "object 0, box 1"),
        ('[{"id": 1, "class_name": "car", "bboxes": [{"position": [1, 2, 0, 4], "rotation": 0}]}]', "positive"),
        ('[{"id": 1, "class_name": "car", "bboxes": [{"position": [1, 2, NaN, 4], "rotation": 0}]}]', "NaN"),
        ("[" * 100_000, "JSON"),
    ],
)
def test_a_damaged_annotation_is_named(tmp_path, text, words):
    (tmp_path / "annotations.json").write_text(text)
    with pytest.raises(FileFormatError, match=words):
        read_tracks(tmp_path / "annotations.json")
