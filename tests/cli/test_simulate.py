"""``farfield simulate``: the files, resuming, workers, refusals."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.frame.provenance import SIMULATION_JOURNAL
from farfield.simulation import simulate_frame


def contents(folder: Path) -> dict[str, bytes]:
    """The data; the journal is that of one set of settings."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != SIMULATION_JOURNAL]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def still_there(out: Path) -> list[psutil.Process]:
    """Workers of a command that was killed, as long as they have not noticed."""
    workers = [process for process in psutil.process_iter(["cmdline", "cwd"]) if process.info["cwd"] == str(out)]
    return [process for process in workers if "farfield.jobs.worker" in (process.info["cmdline"] or ())]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulate") / "mini"
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "1", "--cache"]) == 0
    return out


def test_data_set_reads_back_as_simulated(written: Path) -> None:
    dataset = open_dataset(written)
    assert dataset.name == "cirrus"
    assert list(dataset.sequences) == ["segment_00", "segment_00", "segment_01", "segment_01"]
    frame, expected = dataset[3], simulate_frame("cirrus-sim-mini", sequence=1, index=1)
    assert frame.key == expected.key
    for name in ("gaussian", "uniform"):
        np.testing.assert_allclose(frame.clouds[name].points_m, expected.clouds[name].points_m, atol=1e-4)
        np.testing.assert_allclose(frame.clouds[name].intensity, expected.clouds[name].intensity, atol=1e-5)
    assert frame.boxes is not None
    assert expected.boxes is not None
    np.testing.assert_allclose(frame.boxes.centre_m, expected.boxes.centre_m, atol=1e-5)
    np.testing.assert_array_equal(frame.boxes.label, expected.boxes.label)
    np.testing.assert_array_equal(frame.boxes.point_count, expected.boxes.point_count)


def test_resumes_to_the_same_bytes_with_two_workers(
    written: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "again"
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "2"]) == 0
    whole = contents(out)
    expected = {name: data for name, data in contents(written).items() if ".farfield_cache" not in name}
    assert whole == expected
    lost = sorted(name for name in whole if "uniform" in name)[1]
    (out / lost).unlink()
    capsys.readouterr()
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "1"]) == 0
    assert "4 frames in 2 sequences, 1 still to write" in capsys.readouterr().out
    assert contents(out) == expected


def test_cache_is_added_to_complete_frames(written: Path) -> None:
    assert len(list(written.rglob("*.ffcloud"))) == 8


def test_refuses_a_folder_with_other_things(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert main(["simulate", "cirrus-sim-mini", str(tmp_path)]) == 1
    assert "expected an empty or absent folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_refuses_other_settings_in_the_same_folder(written: Path, capsys: pytest.CaptureFixture) -> None:
    before = contents(written)
    assert main(["simulate", "cirrus-sim-mini", str(written), "--seed", "9"]) == 1
    assert "differs in: seed" in capsys.readouterr().err
    assert contents(written) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cirrus-sim-mini", "OUT", "--stride-s", "2"], "at most 1 s, got 2"),
        (["cirrus-sim-mini", "OUT", "--frames", "500"], "have room for 40 frames, got 500"),
        (["cirrus-sim-mini", "OUT", "--frames", "0"], "expected at least 1, got 0"),
        (["cirrus-sim-val-v2", "OUT", "--seed", "1"], "is frozen"),
        (["cirrus-sim-val-v2", "OUT", "--frames", "500"], "is frozen"),
        (["snowstorm", "OUT"], "expected one of cirrus-sim"),
    ],
)
def test_wrong_arguments(arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "out"
    assert main(["simulate", *[str(out) if word == "OUT" else word for word in arguments]]) == 1
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_full_disk_is_noticed_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000})())
    assert main(["simulate", "cirrus-sim-mini", str(tmp_path / "out")]) == 1
    assert "are needed, 1.00 kB are free" in capsys.readouterr().err


def test_frozen_split_is_compared_with_its_record(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["simulate", "cirrus-sim-val-v2", str(tmp_path / "val"), "--frames", "2", "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "checksums: " in said
    assert "0 different" in said
    settings = json.loads((tmp_path / "val" / "simulation.json").read_text())
    assert settings["seed"] == 731002


def test_killed_at_any_moment_leaves_whole_frames_and_goes_on(written: Path, tmp_path: Path) -> None:
    """SIGKILL to all processes, three times: what carries labels is complete, and the end is as if nothing had been."""
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "farfield.cli", "simulate", "cirrus-sim-mini", str(out)]
    command += ["--frames", "4", "--workers", "2"]
    quiet, fewer = subprocess.DEVNULL, 0
    for frames in (1, 2, 3):
        run = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True, cwd=tmp_path)
        until = time.monotonic() + 120
        while (
            len(list((out / "Cirrus_dataset1" / "dataset1_annotation").glob("*.json"))) < frames and run.poll() is None
        ):
            assert time.monotonic() < until
            time.sleep(0.002)
        os.killpg(run.pid, signal.SIGKILL)
        run.wait(30)
        _, alive = psutil.wait_procs(still_there(tmp_path), timeout=30)
        assert not alive
        root = out / "Cirrus_dataset1"
        labelled = sorted(path.stem for path in (root / "dataset1_annotation").glob("*.json"))
        fewer += len(labelled) < 4
        assert all((root / "dataset1_gaussian" / f"{stem}.xyz").is_file() for stem in labelled)
        assert len(list((root / "dataset1_uniform").glob("*.xyz"))) >= len(labelled)
        expected = contents(written)
        now = contents(out)
        assert not any("unfinished" in name or name.endswith(".part") for name in now)  # the workers cleaned up
        assert all(data == expected[name] for name, data in now.items() if name != "simulation.json")
    assert fewer >= 1
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "1"]) == 0
    assert contents(out) == {name: data for name, data in contents(written).items() if ".farfield_cache" not in name}


def test_a_disk_that_fills_up_stops_the_work_and_loses_nothing(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    out, real, calls = tmp_path / "full", os.fsync, iter(range(1000))

    def failing(descriptor: int) -> None:
        if next(calls) >= 9:  # settings, then frames of three files: the third frame's second file
            raise OSError(errno.ENOSPC, "No space left on device")
        real(descriptor)

    arguments = ["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "1"]
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", failing)
        assert main(arguments) == 1
    assert "the disk is full" in capsys.readouterr().err
    expected = {name: data for name, data in contents(written).items() if ".farfield_cache" not in name}
    left = contents(out)
    assert sum("annotation" in name for name in left) == 2
    assert len(left) == 7
    assert all(data == expected[name] for name, data in left.items())
    assert main(arguments) == 0
    assert contents(out) == expected


def test_sensors_may_be_added_later_and_change_nothing_else(tmp_path: Path) -> None:
    out, whole = tmp_path / "later", tmp_path / "whole"
    few = ["--frames", "2", "--workers", "1"]
    assert main(["simulate", "cirrus-sim-mini", str(out), *few, "--sensors", "gaussian"]) == 0
    before = contents(out)
    assert not any("uniform" in name for name in before)
    assert main(["simulate", "cirrus-sim-mini", str(out), *few]) == 0
    assert main(["simulate", "cirrus-sim-mini", str(whole), *few]) == 0
    assert contents(out) == contents(whole)
    assert all(contents(out)[name] == data for name, data in before.items() if name != "simulation.json")


def test_weather_is_written_beside_the_data(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "snow"
    arguments = ["simulate", "cirrus-sim-mini", str(out), "--frames", "1", "--workers", "1", "--weather", "heavy_snow"]
    assert main([*arguments, "--time", "night"]) == 0
    drawn = json.loads((out / "simulation.json").read_text())["sequences"][0]
    assert drawn["weather"]["condition"] == "heavy_snow"
    assert drawn["weather"]["time"] == "night"
    assert drawn["weather"]["icing"] == 0.6
    assert 1 <= drawn["weather"]["snow_mm_h"] <= 3
    assert f"snow {drawn['weather']['snow_mm_h']:.1f} mm/h" in capsys.readouterr().out
    assert open_dataset(out)[0].conditions["weather"] == "heavy_snow"


def test_kradar_frames_read_back_and_do_not_depend_on_the_workers(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    arguments = ["--frames", "2", "--sequences", "2", "--sensors", "os2-64,sparse"]
    assert main(["simulate", "kradar-sim-mini", str(one), *arguments, "--workers", "1"]) == 0
    assert main(["simulate", "kradar-sim-mini", str(two), *arguments, "--workers", "2"]) == 0
    assert contents(one) == contents(two)
    dataset = open_dataset(one)
    assert dataset.name == "kradar"
    assert list(dataset.sequences) == ["1", "2"]
    frame, expected = dataset[1], simulate_frame("kradar-sim-mini", sequence=1, index=0, sensors=("os2-64", "sparse"))
    assert frame.conditions == {"road": "highway", "weather": "heavy_snow", "time": "night"} == expected.conditions
    np.testing.assert_array_equal(frame.clouds["os2-64"].points_m, expected.clouds["os2-64"].points_m)
    np.testing.assert_array_equal(frame.clouds["os2-64"].extra["ring"], expected.clouds["os2-64"].extra["ring"])
    np.testing.assert_array_equal(frame.radar["sparse"], expected.radar["sparse"])
    assert frame.boxes is not None
    assert expected.boxes is not None
    np.testing.assert_allclose(frame.boxes.centre_m, expected.boxes.centre_m, atol=1e-6)
    np.testing.assert_array_equal(frame.boxes.label, expected.boxes.label)
    assert list(frame.annotation.visibility) == list(expected.annotation.visibility)
