"""Raw recordings: streams with clocks of their own, in bags that the reader opens, with the truth beside."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("embreex")
pytest.importorskip("rosbags")

import farfield as ff
from farfield.cli import main
from farfield.errors import ConfigError, DatasetError
from farfield.files.bags import Bag
from farfield.files.sensor_messages import read_points
from farfield.simulation import find_preset
from farfield.simulation.recording.raw import record_streams
from farfield.simulation.rigs.cirrus import CirrusFrame
from farfield.simulation.rigs.drive import drive_of
from farfield.sync import PoseTrack, deskew

FEW = {"sweeps": 12, "sequences": 1, "sensors": "gaussian,uniform", "workers": 1}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def known(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "segment_00_truth.json").read_text())


@pytest.fixture(scope="module")
def raw(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    return made_once("raw-recording", lambda folder: record_streams("cirrus-sim-mini", folder, **FEW))


def test_each_stream_has_its_messages_and_the_truth_their_times(raw: Path) -> None:
    truth, bag = known(raw), Bag(raw / "segment_00")
    sizes = {topic.name: topic.size for topic in bag.topics}
    assert sizes == {"/gaussian": 12, "/uniform": 12, "/imu_front": 120, "/imu_rear": 120, "/gps": 2, "/tf": 24} | {
        "/tf_static": 1
    }
    stamps = bag.stamps()
    for name, stream in truth["streams"].items():
        true_s = (np.array(stream["true_ns"]) - truth["epoch_ns"]) / 1e9
        found = stamps[f"/{name}"]
        assert sizes[f"/{name}"] == len(true_s)
        times_ns = found.header_ns
        if times_ns is not None:
            read_s = true_s * (1 + stream["drift_ppm"] * 1e-6) + stream["offset_ms"] / 1e3
            error_ms = (times_ns - truth["epoch_ns"]) / 1e6 - read_s * 1e3
            assert np.abs(error_ms).max() < 5 * stream["jitter_ms"] + 1e-6
        computer = truth["computer"]
        logged_s = (found.log_ns - truth["epoch_ns"]) / 1e9
        least_s = (true_s + stream["least_delay_ms"] / 1e3) * (1 + computer["drift_ppm"] * 1e-6)
        late_ms = np.sort(logged_s) * 1e3 - np.sort(least_s) * 1e3 - computer["offset_ms"]
        assert late_ms.min() > -1e-3
        assert late_ms.max() < 60


def test_the_reader_opens_it(raw: Path) -> None:
    data = ff.open_dataset(raw)
    assert data.name == "bags"
    assert len(data) == 12
    frame = data[5]
    assert set(frame.clouds) == {"gaussian", "uniform"}
    assert frame.sensors["uniform"].in_frame  # fixed transforms tell where it sits
    cloud = frame.clouds["gaussian"]
    assert cloud.intensity is not None
    assert 0 <= cloud.extra["offset_ns"].min() < cloud.extra["offset_ns"].max() < 100_000_000
    poses = [data[index].world_T_frame for index in range(1, 12)]
    assert all(pose is not None for pose in poses)
    way = float(np.linalg.norm(poses[-1][:3, 3] - poses[0][:3, 3]))
    assert 5 < way < 40
    imu = data.imu("segment_00", "/imu_front")
    assert imu["acceleration_m_s2"][:, 2].mean() == pytest.approx(9.81, abs=0.4)
    assert len(imu["time_ns"]) == 120


def test_raw_sweeps_deskewed_by_the_true_poses_are_the_simulators_own(raw: Path) -> None:
    """The simulator corrects sweeps exactly: those that are recorded raw become the same."""
    truth, bag = known(raw), Bag(raw / "segment_00")
    rows = np.array(truth["poses"]["world_T_base"]).reshape(-1, 3, 4)
    world_T_base = np.tile(np.eye(4), (len(rows), 1, 1))
    world_T_base[:, :3] = rows
    mount = np.eye(4)
    mount[:3] = np.array(truth["mounts"]["gaussian"]).reshape(3, 4)
    track = PoseTrack(np.array(truth["poses"]["time_ns"]), world_T_base @ mount)
    topic = next(topic for topic in bag.topics if topic.name == "/gaussian")
    message = [bag.decode(topic, each) for _, _, each in bag.messages([topic.name])][6]
    columns = read_points(message, raw)
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    begins = truth["streams"]["gaussian"]["true_ns"][6]
    done = deskew(points, begins + columns["t"].astype(np.int64), track, reference_ns=begins + 50_000_000)
    assert done.left == 0
    preset = replace(find_preset("cirrus-sim-mini"), stride_s=0.1)
    own = CirrusFrame(drive_of(preset, 0, 0), 6).cloud("gaussian").points_m
    assert np.linalg.norm(points - own, axis=1).max() > 0.3
    assert np.linalg.norm(done.points_m - own, axis=1).max() < 0.02


def test_run_again_it_writes_what_is_missing(raw: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    first = record_streams("cirrus-sim-mini", out, **FEW)
    assert first.written == 1
    before = contents(out)
    assert {name: data for name, data in before.items() if name != ".farfield_simulate.jsonl"} == {
        name: data for name, data in contents(raw).items() if name != ".farfield_simulate.jsonl"
    }
    assert record_streams("cirrus-sim-mini", out, **FEW).written == 0
    next(out.rglob("*.mcap")).unlink()
    assert record_streams("cirrus-sim-mini", out, **FEW).written == 1
    assert contents(out) == before
    with pytest.raises(DatasetError, match="raw"):
        ff_record(out)


def ff_record(out: Path) -> None:
    from farfield.simulation.recording import record

    record("cirrus-sim-mini", out, frames=1, workers=1, stride_s=0.1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["kradar-sim-mini"], "a preset of the Cirrus car"),
        (["cirrus-sim-val-v2"], "not frozen"),
        (["cirrus-sim-mini", "--stride-s", "0.5"], "--stride-s"),
        (["cirrus-sim-mini", "--frames", "5000"], "have room for"),
    ],
)
def test_what_does_not_go_together_is_said(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", words[0], str(tmp_path / "out"), "--recording", *words[1:]]) == 1
    assert message in capsys.readouterr().err


def test_a_strange_sensor_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="radar"):
        record_streams("cirrus-sim-mini", tmp_path, sensors="radar")


def test_a_full_disk_is_said_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1_000_000))
    with pytest.raises(DatasetError, match=r"for 12 sweeps about [0-9.]+ [kMG]B are needed, 1.00 MB are free"):
        record_streams("cirrus-sim-mini", tmp_path / "out", **FEW)
    assert not list((tmp_path / "out").rglob("*.mcap"))


@pytest.mark.slow
def test_sync_finds_the_clocks(tmp_path: Path) -> None:
    """Offset and drift of each sensor against the computer, and of one LiDAR against the other, as they are."""
    words = ["simulate", "cirrus-sim-mini", str(tmp_path), "--recording", "--frames", "95", "--sequences", "1"]
    assert main([*words, "--seed", "3"]) == 0
    assert main(["sync", str(tmp_path / "segment_00"), "--to", "/gaussian", "--out", str(tmp_path / "sync")]) == 0
    (found,) = json.loads((tmp_path / "sync" / "sync.json").read_text())["recordings"]
    truth = known(tmp_path)
    for name in ("gaussian", "uniform", "camera", "imu_front", "imu_rear"):
        stream, clock = truth["streams"][name], found["arrivals"][f"/{name}"]
        drift, offset_ms = against_computer(truth, name, clock["middle_ns"])
        assert clock["drift_ppm"] == pytest.approx(drift, abs=4 * clock["drift_se_ppm"] + 3), name
        rest_ms = 0.0 if clock["offset_includes"] == "the least delay" else np.log(2) * stream["mean_rest_of_delay_ms"]
        assert clock["offset_ns"] / 1e6 == pytest.approx(offset_ms + rest_ms, abs=0.5), name
        assert found["streams"][f"/{name}"]["count"] == len(stream["true_ns"])
    own, other, pair = truth["streams"]["gaussian"], truth["streams"]["uniform"], found["pairs"]["/uniform"]
    assert pair["clock"]["drift_ppm"] == pytest.approx(
        other["drift_ppm"] - own["drift_ppm"], abs=4 * pair["clock"]["bound_ppm"]
    )
    apart_ms = other["offset_ms"] - own["offset_ms"] + other["phase_ms"]
    wrapped = (pair["clock"]["offset_ns"] / 1e6 - apart_ms + 50) % 100 - 50
    assert abs(wrapped) < 0.5
    frame = ff.open_dataset(tmp_path)[3]
    assert frame.images["camera"].shape == (108, 320, 3)


def against_computer(truth: dict[str, Any], name: str, middle_ns: int) -> tuple[float, float]:
    """True drift in ppm and offset in ms of the computer's clock against a sensor's, the least delay included."""
    stream, computer = truth["streams"][name], truth["computer"]
    read_s = (middle_ns - truth["epoch_ns"]) / 1e9
    true_s = (read_s - stream["offset_ms"] / 1e3) / (1 + stream["drift_ppm"] * 1e-6)
    arrived_s = true_s + stream["least_delay_ms"] / 1e3
    logged_s = arrived_s * (1 + computer["drift_ppm"] * 1e-6) + computer["offset_ms"] / 1e3
    drift = (1 + computer["drift_ppm"] * 1e-6) / (1 + stream["drift_ppm"] * 1e-6) - 1
    return drift * 1e6, (logged_s - read_s) * 1e3


@pytest.mark.slow
def test_a_recording_that_is_killed_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    words = ["--recording", "--frames", "24", "--sequences", "1", "--sensors", "gaussian", "--workers", "1"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    command = [sys.executable, "-m", "farfield.cli", "simulate", "cirrus-sim-mini"]
    assert subprocess.run([*command, str(tmp_path / "whole"), *words], env=environment).returncode == 0
    killed = subprocess.Popen([*command, str(tmp_path / "killed"), *words], env=environment)
    while killed.poll() is None and not list((tmp_path / "killed").rglob("segment_00/*.mcap")):
        time.sleep(0.005)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    assert killed.returncode == -signal.SIGKILL
    assert not (tmp_path / "killed" / "segment_00" / "metadata.yaml").exists()  # no bag yet
    assert subprocess.run([*command, str(tmp_path / "killed"), *words], env=environment).returncode == 0
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
