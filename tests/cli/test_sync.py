"""``farfield sync`` from lists of stamps to a table, a JSON and a page; real stamps of RADIATE and KITTI raw."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield import cli
from farfield.sync.synchronising import read_match_table

START = 1_700_000_000_000_000_000


@pytest.fixture
def rig(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A lidar at 10 Hz, a camera at 30 Hz that runs 40 ppm fast and 4 ms late, a GPS of another day, a clock's log."""
    folder = tmp_path / "rig"
    folder.mkdir()
    lidar = START + np.arange(600) * 100_000_000 + rng.integers(-500_000, 500_000, 600)
    at = np.arange(1800) * 33_333_333
    camera = START + 4_000_000 + at + np.round(at * 40e-6).astype(np.int64) + rng.integers(-500_000, 500_000, 1800)
    camera = np.delete(camera, [30, 31, 32, 900])
    np.savetxt(folder / "lidar.txt", lidar, fmt="%d")
    lines = [f"{k},{t // 10**9}.{t % 10**9:09d}" for k, t in enumerate(camera.tolist())]
    (folder / "camera.csv").write_text("frame,time_s\n" + "\n".join(lines) + "\n")
    np.savetxt(folder / "gps.txt", START + 86_400_000_000_000 + np.arange(60) * 10**9, fmt="%d")
    (folder / "readme.txt").write_text("Stamps of a rig.\n")
    log = [f"ptp4l[{k}.5]: master offset {v} s2 freq -2500 path delay 560" for k, v in enumerate((-3, 4, 5, 4))]
    (folder / "ptp4l.log").write_text("\n".join(log))
    return folder


def run(folder: Path, *arguments: str) -> dict[str, Any]:
    out = folder.parent / "out"
    assert cli.main(["sync", str(folder), "--out", str(out), *arguments]) == 0
    return json.loads((out / "sync.json").read_text())["recordings"][0]


def test_lists_become_a_table_a_json_and_a_page(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = run(rig, "--to", "lidar", "--tolerance-ms", "17")
    camera = found["pairs"]["camera"]
    assert camera["matched"] == 598
    assert camera["lost"] == 2
    assert camera["clock"]["drift_ppm"] == pytest.approx(40, abs=3 * camera["clock"]["bound_ppm"])
    assert camera["clock"]["offset_ns"] == pytest.approx(4e6 + 40e-6 * 30e9, abs=0.2e6)
    assert camera["clock"]["modulo_ns"] == pytest.approx(33_333_333, abs=5e4)
    assert "two-way exchange" in camera["untold"]
    assert found["streams"]["camera"]["lost"] == 4
    assert found["pairs"]["gps"]["matched"] == 0
    assert found["findings"][0].startswith("gps does not overlap with lidar: it begins 86400.0")
    assert found["exchanges"]["ptp4l.log"]["delay_ns"] == 560
    rows = read_match_table(rig.parent / "out" / "matches.csv")
    assert len(rows["lidar_ns"]) == 600
    assert rows["camera_frame"][10] == ""
    assert rows["camera_frame"][20] == "57"  # three before it are lost
    assert rows["gps_later_ns"] == [""] * 600
    shown = capsys.readouterr().out
    assert "gps does not overlap" in shown
    page = (rig.parent / "out" / "sync.html").read_text()
    assert page.count("data:image") == 2
    assert "does not overlap" in page
    before = (rig.parent / "out" / "matches.csv").read_bytes()
    run(rig, "--to", "lidar", "--tolerance-ms", "17")
    assert (rig.parent / "out" / "matches.csv").read_bytes() == before


def test_the_sign_of_an_offset_is_one_in_the_table_the_words_and_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "rig"
    folder.mkdir()
    for name, later_ns in (("lidar", 0), ("camera", 4_000_000), ("radar", -7_000_000)):
        np.savetxt(folder / f"{name}.txt", START + later_ns + np.arange(60) * 100_000_000, fmt="%d")
    recording = run(folder, "--to", "lidar")
    assert [recording["pairs"][name]["clock"]["offset_ns"] for name in ("camera", "radar")] == [4e6, -7e6]
    rows = read_match_table(tmp_path / "out" / "matches.csv")
    assert (rows["camera_later_ns"][5], rows["radar_later_ns"][5]) == ("4000000", "-7000000")
    printed = capsys.readouterr().out
    assert "camera: 60 matched, 4.000 ms later than lidar" in printed
    assert "radar: 60 matched, 7.000 ms earlier than lidar" in printed
    page = (tmp_path / "out" / "sync.html").read_text()
    assert "+4.000" in page
    assert "-7.000" in page
    assert "+ says that the stream's stamps are later than those of lidar" in page


def test_the_reference_is_chosen_and_said(rig: Path) -> None:
    assert run(rig)["reference"] == "lidar"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "radar"], "expected a stream"),
        (["--tolerance-ms", "-1"], "--tolerance-ms"),
    ],
)
def test_errors_are_clear(rig: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["sync", str(rig), "--out", str(rig.parent / "out"), *arguments]) == 1
    assert message in capsys.readouterr().err
    assert not (rig.parent / "out" / "matches.csv").exists()


def test_a_folder_without_times_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "0000.npy", np.zeros((5, 4), np.float32))
    assert cli.main(["sync", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "nothing in it says when" in capsys.readouterr().err
    assert cli.main(["sync", str(tmp_path / "absent")]) == 1


def test_the_times_of_a_data_set_are_matched(simulated_cirrus: Path, tmp_path: Path) -> None:
    assert cli.main(["sync", str(simulated_cirrus), "--out", str(tmp_path)]) == 0
    (found,) = json.loads((tmp_path / "sync.json").read_text())["recordings"]
    assert {"gaussian", "uniform"} <= set(found["streams"])


def test_radiate(shared_real: Path, tmp_path: Path) -> None:
    folder = shared_real / "time" / "radiate_tiny_foggy"
    arguments = ["sync", str(folder), "--out", str(tmp_path), "--to", "Navtech_Polar", "--tolerance-ms", "50"]
    assert cli.main(arguments) == 0
    (found,) = json.loads((tmp_path / "sync.json").read_text())["recordings"]
    assert found["pairs"]["velo_lidar"]["matched"] == 17  # the eighteenth lies outside the lidar's span
    assert found["pairs"]["velo_lidar"]["outside"] == 1
    assert found["pairs"]["velo_lidar"]["clock"] is None  # 4.04 and 9.99 Hz: no whole ratio
    assert found["pairs"]["GPS_IMU_Twist"]["matched"] == 0
    assert found["findings"][0].startswith(
        "GPS_IMU_Twist does not overlap with Navtech_Polar: it begins 64.005 s after"
    )
    assert found["streams"]["GPS_IMU_Twist"]["duplicates"] == 125
    assert found["streams"]["GPS_IMU_Twist"]["backwards"] == 1
    rows = read_match_table(tmp_path / "matches.csv")
    assert rows["Navtech_Polar_frame"][:2] == ["000001", "000002"]
    assert rows["velo_lidar_frame"][0] == "000018"


def test_kitti_raw_has_start_middle_and_end(shared_real: Path, tmp_path: Path) -> None:
    folder = shared_real / "kitti_raw" / "2011_09_26"
    assert cli.main(["sync", str(folder), "--out", str(tmp_path), "--to", "velodyne_points"]) == 0
    (found,) = json.loads((tmp_path / "sync.json").read_text())["recordings"]
    assert found["name"] == "2011_09_26_drive_0001_sync"
    pairs = found["pairs"]
    start, end = pairs["velodyne_points/start"], pairs["velodyne_points/end"]
    assert start["matched"] + end["matched"] >= 107
    assert pairs["image_02"]["matched"] == 108
    assert pairs["image_02"]["residual"]["mean_ms"] == pytest.approx(10.5, abs=1)
    assert pairs["image_02"]["residual"]["worst_ms"] < 19.4


def test_kitti_raw_with_a_lost_sweep_keeps_the_numbers(tmp_path: Path) -> None:
    """Drives of KITTI raw lack single sweeps: a number is left out, and its line too."""
    drive = tmp_path / "day" / "drive"
    for name, numbers in (("velodyne_points", (0, 1, 3, 4)), ("image_02", range(5))):
        (drive / name / "data").mkdir(parents=True)
        lines = [f"2011-09-26 13:02:25.{100 * number:03d}000000" for number in numbers]
        (drive / name / "timestamps.txt").write_text("\n".join(lines) + "\n")
        for number in numbers:
            (drive / name / "data" / f"{number:010d}.bin").touch()
    assert cli.main(["sync", str(tmp_path / "day"), "--to", "image_02", "--out", str(tmp_path / "out")]) == 0
    rows = read_match_table(tmp_path / "out" / "matches.csv")
    assert rows["image_02_frame"] == [f"{number:010d}" for number in range(5)]
    assert rows["velodyne_points_frame"] == ["0000000000", "0000000001", "", "0000000003", "0000000004"]


def test_kitti_stamps_keep_their_period(shared_real: Path, tmp_path: Path) -> None:
    folder = shared_real / "time" / "kitti_raw_stamps"
    assert cli.main(["sync", str(folder), "--out", str(tmp_path), "--to", "timestamps", "--tolerance-ms", "60"]) == 0
    (found,) = json.loads((tmp_path / "sync.json").read_text())["recordings"]
    assert found["streams"]["timestamps"]["period_ns"] / 1e6 == pytest.approx(103.559, abs=0.001)
    assert found["streams"]["timestamps"]["gaps"] == 0
    assert found["pairs"]["timestamps_start"]["residual"]["mean_ms"] == pytest.approx(-51.8, abs=0.1)
    assert found["pairs"]["timestamps_end"]["matched"] == 361
