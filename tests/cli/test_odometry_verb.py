"""``farfield odometry`` from sweeps to poses beside the data, and what takes them; killed, it goes on."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from blocks_of_houses import drive

import farfield as ff
from farfield import cli
from farfield.datasets.maps import Posed, Sweeps, make
from farfield.errors import ConfigError, DatasetError
from farfield.files.poses_csv import read_poses


def _write(folder: Path, count: int, points: int = 3000) -> np.ndarray:
    sweeps, true = drive(count, points=points)
    folder.mkdir()
    for number, sweep in enumerate(sweeps):
        rows = np.column_stack([sweep.points_m, np.full(len(sweep.points_m), 0.3)])
        np.save(folder / f"{number:04d}.npy", rows.astype(np.float32))
    return true


def _read(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def test_poses_are_written_beside_the_data_and_taken_by_what_opens_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / "street", tmp_path / "out"
    true = _write(data, 6)
    before = _read(data)
    command = ["odometry", str(data), "--out", str(out), "--workers", "1", "--picture", str(out / "track.png")]
    assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "6 sweeps" in said
    assert "drift not known" in said  # shorter than 10 m
    assert _read(data) == before
    (file,) = (out / "poses").iterdir()
    table = read_poses(file)
    off = np.linalg.norm(table.world_T_frame[:, :3, 3] - true[:, :3, 3], axis=1)
    assert off.max() < 0.1
    content = json.loads((out / "odometry.json").read_text())["tracks"][0]
    assert (content["sweeps"], content["lost"], content["expected_drift"]) == (6, 0, None)
    assert content["way_m"] == pytest.approx(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum(), rel=0.03)
    page = (out / "odometry.html").read_text()
    assert "Tracks from above" in page
    assert 'src="http' not in page
    assert (out / "track.png").read_bytes()[:4] == b"\x89PNG"

    posed = ff.open_dataset(data, poses=out)
    own, (seen,) = posed[3].world_T_frame, posed.drives()
    assert own is not None
    assert seen.world_T_frame is not None
    np.testing.assert_allclose(own, table.world_T_frame[3])
    np.testing.assert_allclose(seen.world_T_frame, table.world_T_frame)
    assert ff.open_dataset(data)[3].world_T_frame is None
    assert make("posed", {"poses": str(out)}) == Posed(out)
    assert Posed(out).fits(posed)
    assert not Posed(tmp_path / "nowhere").fits(posed)
    with pytest.raises(ConfigError, match="farfield odometry"):
        ff.open_dataset(data, poses=tmp_path / "nowhere")[0]
    moved = posed.turned(90)[3].world_T_frame
    assert moved is not None
    np.testing.assert_allclose(moved[:3, 3], table.world_T_frame[3, :3, 3], atol=1e-9)
    with pytest.raises(ConfigError, match="of lidar"):
        ff.open_dataset(data).turned(90).mapped(Posed(out))[3]
    with pytest.raises(DatasetError, match="no time"):  # sweeps need times besides
        posed.mapped(Sweeps(2))[3]
    # The same command again does nothing and writes the same.
    written = _read(out)
    assert cli.main(command) == 0
    assert _read(out) == written


def test_wrong_uses_say_how_to_mend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "street"
    _write(data, 2, points=300)
    for arguments, said in (
        (["--out", str(data / "poses")], "outside of the data"),
        (["--cloud", "radar", "--out", str(tmp_path / "out")], "no cloud radar"),
        (["--drives", "nine", "--out", str(tmp_path / "out")], "--drives"),
        (["--picture", "track.gif"], ".svg"),
        (["--step-s", "0", "--out", str(tmp_path / "out")], "step_s"),
    ):
        assert cli.main(["odometry", str(data), "--workers", "1", *arguments]) == 1
        assert said in capsys.readouterr().err
    assert cli.main(["track", "x.csv", "--poses", str(tmp_path), "--out", str(tmp_path / "tracks.csv")]) == 1
    assert "--data" in capsys.readouterr().err


@pytest.mark.slow
def test_killed_in_the_middle_of_a_drive_it_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    data, out, whole = tmp_path / "street", tmp_path / "out", tmp_path / "whole"
    _write(data, 130, points=2000)
    common = [sys.executable, "-c", "import sys; from farfield import cli; sys.exit(cli.main())", "odometry", str(data)]
    common += ["--workers", "1", "--out"]
    subprocess.run([*common, str(whole)], check=True, capture_output=True)
    killed = 0
    for kind in ("poses", "backward"):
        process = subprocess.Popen([*common, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 300
        while process.poll() is None and time.monotonic() < deadline:
            if list((out / ".checkpoints").glob(f"{kind}-*.npz")):
                os.kill(process.pid, signal.SIGKILL)
                killed += 1
                break
            time.sleep(0.01)
        process.wait()
    assert killed == 2
    subprocess.run([*common, str(out)], check=True, capture_output=True)
    assert _read(out) == _read(whole)
