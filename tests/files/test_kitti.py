"""KITTI's text files: real ones, round trips, and everything that can be wrong with a line."""

import time
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.kitti import (
    KittiTracks,
    read_calib,
    read_detections,
    read_labels,
    read_tracking,
    write_labels,
    write_tracking,
)

CAR = "Car 0.00 0 1.85 387.63 181.54 423.81 203.12 1.67 1.87 3.69 -16.53 2.39 58.49 1.57"
DONTCARE = "DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10"
DETECTION = "0,2,298.3125,165.18,458.2292,293.4391,8.2981,1.9605,1.8137,4.7549,-4.572,1.8435,13.5308,-2.1125,-1.7867"


def write(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "file.txt"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_a_label_line(tmp_path: Path) -> None:
    objects = read_labels(write(tmp_path, f"{CAR}\n\n{DONTCARE}\n"))
    assert objects.type.tolist() == ["Car", "DontCare"]
    assert objects.box_px[0].tolist() == [387.63, 181.54, 423.81, 203.12]
    assert objects.size_m[0].tolist() == [1.67, 1.87, 3.69]
    assert objects.bottom_m[0].tolist() == [-16.53, 2.39, 58.49]
    assert objects.rotation_y_rad[0] == 1.57
    assert objects.occlusion.tolist() == [0, -1]
    assert objects.has_box.tolist() == [True, False]
    assert objects.line.tolist() == [1, 3]
    assert objects.score is None
    assert len(objects[objects.has_box]) == 1


def test_an_empty_file_is_a_frame_without_objects(tmp_path: Path) -> None:
    for text in ("", "\n\n"):
        objects = read_labels(write(tmp_path, text))
        assert len(objects) == 0
        assert objects.box_px.shape == (0, 4)
        assert objects.has_box.shape == (0,)
    assert len(read_tracking(write(tmp_path, ""))) == 0
    assert len(read_detections(write(tmp_path, ""))) == 0


def test_labels_and_tracks_survive_a_round_trip(tmp_path: Path) -> None:
    scored = read_labels(write(tmp_path, f"{CAR} 0.123456789012345\n"))
    write_labels(tmp_path / "labels.txt", scored)
    again = read_labels(tmp_path / "labels.txt")
    for name in (
        "type",
        "truncation",
        "occlusion",
        "alpha_rad",
        "box_px",
        "size_m",
        "bottom_m",
        "rotation_y_rad",
        "score",
    ):
        np.testing.assert_array_equal(getattr(scored, name), getattr(again, name))
    tracks = KittiTracks(frame=np.array([7]), track_id=np.array([3]), objects=scored)
    write_tracking(tmp_path / "tracks.txt", tracks)
    back = read_tracking(tmp_path / "tracks.txt")
    assert (back.frame.tolist(), back.track_id.tolist()) == ([7], [3])
    np.testing.assert_array_equal(back.objects.bottom_m, scored.bottom_m)


def test_detections(tmp_path: Path) -> None:
    tracks = read_detections(write(tmp_path, f"{DETECTION}\n{DETECTION.replace('0,2,', '5,1,', 1)}\n"))
    assert tracks.frame.tolist() == [0, 5]
    assert tracks.track_id.tolist() == [-1, -1]
    assert tracks.objects.type.tolist() == ["Car", "Pedestrian"]
    assert tracks.objects.score[0] == 8.2981
    assert tracks.objects.size_m[0].tolist() == [1.9605, 1.8137, 4.7549]
    assert tracks.objects.bottom_m[0].tolist() == [-4.572, 1.8435, 13.5308]
    assert tracks.objects.rotation_y_rad[0] == -2.1125
    assert tracks[tracks.frame == 5].objects.type.tolist() == ["Pedestrian"]


@pytest.mark.parametrize(
    ("text", "where", "found"),
    [
        (CAR.rsplit(" ", 1)[0], "line 1", "14"),
        (f"{CAR} 0.5 7", "line 1", "17"),
        (f"{CAR}\n{CAR} 0.5", "line 2", "16"),
        (CAR.replace("1.67", "tall"), "line 1", "'tall'"),
        (f"{CAR}\n" + CAR.replace("1.67", "nan"), "line 2", "'nan'"),
        (CAR.replace("58.49", "inf"), "line 1", "'inf'"),
        (CAR.replace("0.00 0", "0.00 0.5"), "line 1", "0.5"),
        (CAR.encode() + b"\xff", "byte", "0xff"),
    ],
)
def test_a_wrong_label_line_is_named(tmp_path: Path, text: str | bytes, where: str, found: str) -> None:
    with pytest.raises(FileFormatError, match=where) as error:
        read_labels(write(tmp_path, text))
    assert found in str(error.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (DETECTION.rsplit(",", 1)[0], "15 comma-separated"),
        (DETECTION.replace("0,2,", "0,9,", 1), "type code"),
        (DETECTION.replace("0,2,", "0.5,2,", 1), "whole numbers"),
        (DETECTION.replace("0,2,", "-1,2,", 1), "frame number from 0"),
        (DETECTION.replace("0,2,", "1e300,2,", 1), "whole numbers"),
        (DETECTION.replace("8.2981", ""), "a number"),
        (f"{DETECTION}\n0,2", "line 2"),
    ],
)
def test_a_wrong_detection_is_named(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(FileFormatError, match=expected):
        read_detections(write(tmp_path, text))


def test_calibration(tmp_path: Path) -> None:
    twelve, nine = " ".join(map(str, range(12))), " ".join(map(str, range(9)))
    calib = read_calib(write(tmp_path, f"P2: {twelve}\nR_rect {nine}\n\n"))
    assert calib["P2"].tolist()[1] == [4.0, 5.0, 6.0, 7.0]
    assert calib["R_rect"].shape == (3, 3)
    for text in ("", f"P2: {twelve} 1", f"P2: {twelve}\nP2: {twelve}", f"P2: {twelve.replace('3', 'x')}"):
        with pytest.raises(FileFormatError):
            read_calib(write(tmp_path, text))


def test_real_files(shared_real: Path) -> None:
    objects = read_labels(shared_real / "kitti" / "training" / "label_2" / "000001.txt")
    assert objects.type.tolist()[:3] == ["Truck", "Car", "Cyclist"]
    calib = read_calib(shared_real / "kitti" / "training" / "calib" / "000001.txt")
    assert {name: matrix.shape for name, matrix in calib.items()} == {
        **{f"P{i}": (3, 4) for i in range(4)},
        "R0_rect": (3, 3),
        "Tr_velo_to_cam": (3, 4),
        "Tr_imu_to_velo": (3, 4),
    }
    tracks = read_tracking(shared_real / "kitti_tracking" / "label" / "0020.txt")
    assert len(tracks) == 8896
    detections = read_detections(shared_real / "kitti_tracking" / "detections_pointrcnn_car" / "0020.txt")
    assert len(detections) == 7898


def test_mutated_files_give_one_clear_error_or_valid_rows(tmp_path: Path, rng: np.random.Generator) -> None:
    whole = {
        read_labels: f"{CAR}\n{DONTCARE}\n".encode(),
        read_tracking: f"0 1 {CAR}\n12 -1 {DONTCARE}\n".encode(),
        read_detections: f"{DETECTION}\n{DETECTION}\n".encode(),
        read_calib: ("P2: " + " ".join(["1.5"] * 12)).encode(),
    }
    start = time.monotonic()
    for reader, data in whole.items():
        for _ in range(150):
            broken = bytearray(data[: rng.integers(0, len(data) + 1)] if rng.integers(2) else data)
            for place in rng.integers(0, max(len(broken), 1), rng.integers(0, 4)):
                if len(broken):
                    broken[place] = rng.choice(np.frombuffer(b"\x00 \n,.-+eE_xn0123456789\xff\"'", dtype=np.uint8))
            try:
                found = reader(write(tmp_path, bytes(broken)))
            except FileFormatError:
                continue
            if isinstance(found, KittiTracks):
                assert np.isfinite(found.objects.bottom_m).all()
    assert time.monotonic() - start < 60
