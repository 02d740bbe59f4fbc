"""Wrong inputs D and E of ``fifty.md``, geometry and time: an error or a warning names the fault, or all is right."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from wrong_inputs import (
    FRAMES,
    HEADER,
    Capsys,
    findings,
    refused,
    row,
    run,
    says,
    score,
    table,
)

from farfield.api import open_dataset
from farfield.cli import main
from farfield.errors import FarfieldError

# D. Geometry that contradicts itself.

AXES = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]


def calibrated(
    base: Path, *, focal: float = 1000.0, scale: float = 1.0, pixels: tuple[int, int] = (1920, 1080)
) -> None:
    """A camera that looks ahead, and an image beside each sweep."""
    motion = np.array(AXES, dtype=float)
    motion[:3, :3] *= scale
    camera = {"matrix": [[focal, 0, 960], [0, focal, 540], [0, 0, 1]], "camera_T_lidar": motion.tolist()}
    (base / "calibration.yaml").write_text(json.dumps(camera | {"width": 1920, "height": 1080}))
    for number in range(FRAMES):
        Image.new("RGB", pixels, (90, 90, 90)).save(base / f"{number:04d}.jpg")


def poses(base: Path, *, x_m: Sequence[float] = (0, 1, 2, 3), quaternion: str = "0,0,0,1") -> Path:
    header = "sequence,frame,reference,time_ns,x_m,y_m,z_m,qx,qy,qz,qw,state,blind"
    rows = [f"drive,{number:04d},lidar,,{x},0,0,{quaternion},placed," for number, x in enumerate(x_m)]
    path = base.parent / "drive.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_a_sound_camera_is_not_warned_of(base: Path, capsys: Capsys) -> None:
    calibrated(base)
    assert findings(capsys, base) == ""


def test_d1_an_image_of_another_size(base: Path, capsys: Capsys) -> None:
    calibrated(base, pixels=(320, 240))
    says(findings(capsys, base), "320 x 240", "1920 x 1080")


def test_d2_a_focal_length_in_millimetres(base: Path, capsys: Capsys) -> None:
    calibrated(base, focal=4.0)
    says(findings(capsys, base), "focal", "pixels")


def test_d3_no_rotation(base: Path, capsys: Capsys) -> None:
    calibrated(base, scale=2.0)
    says(findings(capsys, base), "calibration.yaml", "rotation")


def test_d4_a_quaternion_of_zeros(base: Path) -> None:
    with pytest.raises(FarfieldError, match=r"(?s)line 2.*unit quaternion"):
        _ = open_dataset(base, poses=poses(base, quaternion="0,0,0,0"))[1].world_T_frame


def in_drive(predictions: Path) -> Path:
    """The same table with the name of the sequence."""
    lines = predictions.read_text().splitlines()
    path = predictions.with_name("in_drive.csv")
    path.write_text("\n".join([f"sequence,{lines[0]}", *(f"drive,{line}" for line in lines[1:])]) + "\n")
    return path


def test_d5_w_first(base: Path, predictions: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ("--data", base, "--poses", poses(base, quaternion="1,0,0,0"), "--out", tmp_path / "tracks.csv")
    says(run(capsys, "track", in_drive(predictions), *words)[1], "upside down")


def test_d4_underscores_in_poses(base: Path) -> None:
    """A brother of C5."""
    path = poses(base)
    path.write_text(path.read_text().replace(",2,0,0,", ",2_0,0,0,"))
    with pytest.raises(FarfieldError, match=r"(?s)line 4.*2_0"):
        _ = open_dataset(base, poses=path)[1].world_T_frame


def test_d6_a_jump(base: Path, predictions: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ("--data", base, "--poses", poses(base, x_m=(0, 1, 1002, 3)), "--out", tmp_path / "tracks.csv")
    says(run(capsys, "track", in_drive(predictions), *words)[1], "poses", "0002", "jump")


def test_d7_kittis_motion_inverted(base: Path, tmp_path: Path, capsys: Capsys) -> None:
    calibrated(base)
    assert main(["convert", str(base), str(tmp_path / "kitti"), "--to", "kitti"]) == 0
    for path in (tmp_path / "kitti" / "training" / "calib").glob("*.txt"):
        lines = path.read_text().splitlines()
        at = next(number for number, line in enumerate(lines) if line.startswith("Tr_velo_to_cam"))
        motion = np.array(lines[at].split()[1:], dtype=float).reshape(3, 4)
        lines[at] = "Tr_velo_to_cam: " + " ".join(map(str, np.column_stack([motion[:, :3].T, motion[:, 3]]).ravel()))
        path.write_text("\n".join(lines) + "\n")
    says(findings(capsys, tmp_path / "kitti"), "calibration", "invert")


# E. Tracks and time.


def test_e1_an_identity_twice_in_a_frame(base: Path, predictions: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([*map(row, range(4)), row(1, x=30)]))
    refused(score(capsys, predictions, base / "labels.csv", "--protocol", "tracking"), "0001", "3")


def test_e2_an_identity_of_two_classes(base: Path, capsys: Capsys) -> None:
    labels = ["vehicle", "vehicle", "bicycle", "bicycle"]
    (base / "labels.csv").write_text(table([row(number, label=label) for number, label in enumerate(labels)]))
    says(findings(capsys, base), "track 3", "bicycle", "vehicle")


def test_e3_an_identity_that_jumps(base: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(0), row(1), row(2, x=112), row(3, x=113)]))
    says(findings(capsys, base), "track 3", "0002", "100 m")


def test_e4_a_heading_that_flips(base: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(number, yaw=("0", "3.14159")[number % 2]) for number in range(4)]))
    says(findings(capsys, base), "track 3", "turns")


def test_e5_gps_and_utc(base: Path, capsys: Capsys) -> None:
    text = (base / "labels.csv").read_text()
    for number in range(FRAMES):
        name = str(1_700_000_000_000_000_000 + number * 100_000_000 + (number > 1) * 18_000_000_000)
        (base / f"{number:04d}.npy").rename(base / f"{name}.npy")
        text = text.replace(f"{number:04d},", f"{name},")
    (base / "labels.csv").write_text(text)
    says(findings(capsys, base), "stamps", "18.1 s", "GPS")


def stamps(folder: Path, name: str, lines: Sequence[str]) -> None:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")


def test_e6_zones(tmp_path: Path, capsys: Capsys) -> None:
    folder = tmp_path / "stamps"
    stamps(folder, "lidar", [f"2024-05-01T12:00:{number:02d}.500+02:00" for number in range(20)])
    stamps(folder, "camera", [f"2024-05-01T10:00:{number:02d}.504Z" for number in range(20)])
    status, text = run(capsys, "sync", folder, "--out", tmp_path / "out")
    assert status == 0, text
    figures = json.loads((tmp_path / "out" / "sync.json").read_text())
    assert "20" in text
    assert "4.0" in text or "4.0" in json.dumps(figures)


def test_e7_stamps_of_32_bits(tmp_path: Path, capsys: Capsys) -> None:
    folder, start = tmp_path / "stamps", 3_900_000_000
    times = [(start + number * 100_000_000) % 2**32 for number in range(20)]
    stamps(folder, "lidar", [str(time) for time in times])
    stamps(folder, "camera", [str(time + 2_000_000) for time in times])
    text = run(capsys, "sync", folder, "--unit", "ns", "--out", tmp_path / "out")[1]
    says(text, "lidar", "backward", "32 bit")


def test_e8_velocities_in_kilometres_an_hour(base: Path, capsys: Capsys) -> None:
    rows = [f"{row(number)},36,0" for number in range(FRAMES)]
    text = table(rows, f"{HEADER},vx_m_s,vy_m_s")
    for number in range(FRAMES):
        name = str(1_700_000_000_000_000_000 + number * 100_000_000)
        (base / f"{number:04d}.npy").rename(base / f"{name}.npy")
        text = text.replace(f"{number:04d},", f"{name},")
    (base / "labels.csv").write_text(text)
    says(findings(capsys, base), "velocit", "km/h")
