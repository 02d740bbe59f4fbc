"""``farfield track`` from detections to a score: KITTI's text, our CSV, nuScenes' JSON."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from farfield import cli
from farfield.files.boxes_csv import read_boxes_csv
from farfield.files.kitti import read_tracking


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """Two cars in two sequences: detections, and labels of the same."""
    (tmp_path / "found").mkdir()
    (tmp_path / "label").mkdir()
    for sequence in ("0000", "0001"):
        found, label = [], []
        for frame in range(8):
            for car, x in enumerate((-3.0, 4.0)):
                z = 12.0 + 10 * car + 0.4 * frame
                px = f"{300 + 100 * car},150,{380 + 100 * car},210"
                found.append(f"{frame},2,{px},{5.5 - car},1.5,1.6,4.0,{x},1.7,{z},-1.57,0.1")
                label.append(f"{frame} {car + 3} Car 0 0 0.1 {px.replace(',', ' ')} 1.5 1.6 4.0 {x} 1.7 {z} -1.57")
        (tmp_path / "found" / f"{sequence}.txt").write_text("\n".join(found) + "\n")
        (tmp_path / "label" / f"{sequence}.txt").write_text("\n".join(label) + "\n")
    return tmp_path


def test_detections_become_tracks_that_score_whole(drives: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(drives / "found"), "--format", "kitti-tracking", "--preset", "ab3dmot", "--out"]
    assert cli.main(["track", *arguments, str(drives / "tracks")]) == 0
    assert "4 tracks, 32 boxes in 16 frames" in capsys.readouterr().out
    written = read_tracking(drives / "tracks" / "0001.txt")
    assert sorted({*written.track_id.tolist()}) == [0, 1]
    assert written.objects.score is not None
    np.testing.assert_allclose(written.objects.box_px[0], [300, 150, 380, 210])
    scored = [str(drives / "tracks"), str(drives / "label"), "--format", "kitti-tracking", "--label", "Car"]
    out = drives / "score.json"
    assert cli.main(["score", *scored, "--protocol", "tracking", "--iou", "0.25", "--json", str(out)]) == 0
    got = json.loads(out.read_text())["tracking"]
    assert {name: got[name] for name in ("MOTA", "IDS", "FRAG", "AssA")} == {"MOTA": 1, "IDS": 0, "FRAG": 0, "AssA": 1}
    assert {"sAMOTA", "AMOTA", "AMOTP", "MOTP", "HOTA", "DetA"} <= set(got)
    assert cli.main(["score", *scored, "--protocol", "tracking", "--least-track-score", "5", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["tracking"]["DetRe"] == pytest.approx(0.5)
    # The same command again gives the same bytes.
    before = (drives / "tracks" / "0000.txt").read_bytes()
    assert cli.main(["track", *arguments, str(drives / "again")]) == 0
    assert (drives / "again" / "0000.txt").read_bytes() == before


def test_csv_and_nuscenes_hold_identities_and_velocities(drives: Path) -> None:
    common = ["track", str(drives / "found"), "--format", "kitti-tracking"]
    assert cli.main([*common, "--smooth", "--to", "boxes-csv", "--out", str(drives / "tracks.csv")]) == 0
    rows = read_boxes_csv(drives / "tracks.csv")
    assert rows.track_id is not None
    assert rows.velocity_m_s is not None
    np.testing.assert_allclose(rows.velocity_m_s[:, 0], 4.0, atol=0.2)
    again = drives / "again.csv"
    assert cli.main(["track", str(drives / "tracks.csv"), "--out", str(again), "--least-track-score", "5"]) == 0
    assert len(read_boxes_csv(again)) == len(rows) // 2
    # nuScenes' scores lie in [0, 1], and a token stands for one sample.
    assert cli.main([*common, "--to", "nuscenes", "--out", str(drives / "bad.json")]) == 1
    text = (drives / "again.csv").read_text().replace(",5.5,", ",0.5,")
    (drives / "one.csv").write_text("\n".join(line for line in text.splitlines() if not line.startswith("0001")) + "\n")
    assert cli.main(["track", str(drives / "one.csv"), "--to", "nuscenes", "--out", str(drives / "one.json")]) == 0
    results = json.loads((drives / "one.json").read_text())["results"]
    first = results["6"][0]
    assert first["size"] == pytest.approx([1.6, 4.0, 1.5])
    assert first["tracking_id"] == "0000:0"
    assert first["velocity"][0] == pytest.approx(4.0, abs=0.5)


def test_options_by_name_and_tracks_joined_afterwards(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A car that is hidden for 2 s: two tracks, or one; with an option by name it lives on."""
    lines = ["frame,label,x,y,z,l,w,h,yaw_rad,score"]
    lines += [f"{frame},Car,{20 + frame},0,0,4,2,1.5,0,0.95" for frame in range(50) if not 20 <= frame < 40]
    found, out = tmp_path / "found.csv", tmp_path / "out.csv"
    found.write_text("\n".join(lines) + "\n")
    for extra, said in (
        ([], "default, online: 2 tracks"),
        (["--join-s", "5"], "default, offline (joined): 1 track"),
        (["--join-s", "1"], "default, offline (joined): 2 tracks"),
        (["--preset", "annotated", "--join-s", "30"], "annotated, offline (joined): 1 track"),
        (["-o", "max_age_s=3", "-o", "gate=4"], "default, online: 1 track"),
    ):
        assert cli.main(["track", str(found), "--out", str(out), *extra]) == 0
        assert said in capsys.readouterr().out
    longer = tmp_path / "longer.csv"
    longer.write_text("\n".join([*lines[:21], *(line.replace(",0,0,4,", ",0,0,4.2,") for line in lines[21:])]) + "\n")
    for extra, said in (
        (["--join-s", "5"], "default, offline (joined): 1 track"),
        (["--preset", "annotated", "--join-s", "30"], "annotated, offline (joined): 2 tracks"),
    ):
        assert cli.main(["track", str(longer), "--out", str(out), *extra]) == 0
        assert said in capsys.readouterr().out
    assert cli.main(["track", str(found), "--out", str(out), "-o", "age=3"]) == 1
    assert "expected options among" in capsys.readouterr().err


def test_what_cannot_be_is_said(drives: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["track", str(drives / "nowhere"), "--out", "x"]) == 1
    assert "found nothing there" in capsys.readouterr().err
    arguments = [str(drives / "found"), "--format", "kitti-tracking", "--preset", "sort", "--out", str(drives / "x")]
    assert cli.main(["track", *arguments]) == 1
    assert "preset: expected one of default, offline, unposed, annotated, ab3dmot" in capsys.readouterr().err
    scored = ["score", str(drives / "found"), str(drives / "label"), "--format", "kitti-tracking", "--label", "Car"]
    assert cli.main([*scored, "--protocol", "tracking"]) == 1
    assert "farfield track" in capsys.readouterr().err


def uneven_drive(folder: Path) -> tuple[Path, Path]:
    """Clouds at steps of 0.1 and 0.3 s named by their stamps, and detections of a car that comes nearer at 8 m/s."""
    data = folder / "data" / "drive"
    data.mkdir(parents=True)
    lines, time_ns = ["sequence,frame,label,x,y,z,l,w,h,yaw_rad,score"], 1_700_000_000_000_000_000
    for number in range(12):
        np.save(data / f"{time_ns}.npy", np.ones((4, 4), dtype=np.float32))
        x = 60 - 8 * (time_ns - 1_700_000_000_000_000_000) / 1e9
        lines.append(f"drive,{time_ns},Car,{x},2,0,4,2,1.5,0,0.95")
        time_ns += 300_000_000 if number % 2 else 100_000_000
    (folder / "found.csv").write_text("\n".join(lines) + "\n")
    return data, folder / "found.csv"


def test_stamps_are_those_of_the_data_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, found = uneven_drive(tmp_path)
    out, picture = tmp_path / "tracks.csv", tmp_path / "trails.png"
    arguments = ["track", str(found), "--data", str(data), "--out", str(out), "--picture", str(picture)]
    assert cli.main(arguments) == 0
    said = capsys.readouterr().out
    assert "steps of" not in said
    assert "the data have no poses" in said
    rows = read_boxes_csv(out)
    assert len(rows) == 12
    assert rows.velocity_m_s is not None
    np.testing.assert_allclose(rows.velocity_m_s[-1, :2], [-8, 0], atol=0.1)
    assert picture.read_bytes().startswith(b"\x89PNG")
    before = out.read_bytes(), picture.read_bytes()
    assert cli.main(arguments) == 0
    assert (out.read_bytes(), picture.read_bytes()) == before
    assert cli.main(["track", str(found), "--out", str(out)]) == 0
    assert "steps of 0.1 s" in capsys.readouterr().out
    assert read_boxes_csv(out).velocity_m_s[-1, 0] < -10  # type: ignore[index]


def test_frames_that_the_data_do_not_have_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, found = uneven_drive(tmp_path)
    strange, out = tmp_path / "strange.csv", tmp_path / "x.csv"
    strange.write_text(found.read_text() + "drive,000099,Car,10,0,0,4,2,1.5,0,0.9\n")
    assert cli.main(["track", str(strange), "--data", str(data), "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "drive/000099" in said
    assert "1 of 13 are not there" in said
    assert cli.main(["track", str(found), "--out", str(out), "--picture", str(tmp_path / "x.gif")]) == 1
    assert "expected a name that ends with .svg" in capsys.readouterr().err
    assert not out.exists()


def test_radial_velocities_of_the_csv_are_taken(tmp_path: Path) -> None:
    """A car at 60 m that drives away at 12 m/s is known to do so at its second detection, modulo the span too."""
    lines = ["frame,label,x,y,z,l,w,h,yaw_rad,score,doppler_m_s"]
    rng = np.random.default_rng(0)
    places = 60 + 1.2 * np.arange(12) + rng.normal(0, 0.3, 12)
    lines += [f"{frame},Car,{x},0,0,4,2,1.5,0,0.95,12" for frame, x in enumerate(places)]
    found, out = tmp_path / "found.csv", tmp_path / "out.csv"
    found.write_text("\n".join(lines) + "\n")
    assert cli.main(["track", str(found), "--out", str(out)]) == 0
    first = read_boxes_csv(out).velocity_m_s
    assert first is not None
    np.testing.assert_allclose(first[:, 0], 12.0, atol=0.2)
    wrapped = 12 - 3 * 3.865
    found.write_text("\n".join([lines[0], *(f"{line.rsplit(',', 1)[0]},{wrapped}" for line in lines[1:])]) + "\n")
    assert cli.main(["track", str(found), "--out", str(out), "--doppler-span-m-s", "3.865"]) == 0
    later = read_boxes_csv(out).velocity_m_s
    assert later is not None
    np.testing.assert_allclose(later[-1, 0] % 3.865, 12 % 3.865, atol=0.3)


def test_a_killed_command_leaves_no_half_file_and_runs_again_to_the_same_bytes(tmp_path: Path) -> None:
    folder = tmp_path / "found"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for sequence in range(6):
        rows = [
            f"{frame},2,300,150,380,210,5.5,1.5,1.6,4.0,{x:.3f},1.7,{z:.3f},-1.57,0.1"
            for frame in range(60)
            for x, z in rng.uniform([-20, 5], [20, 70], (10, 2))
        ]
        (folder / f"{sequence:04d}.txt").write_text("\n".join(rows) + "\n")
    command = ["track", str(folder), "--format", "kitti-tracking", "--out"]
    assert cli.main([*command, str(tmp_path / "whole")]) == 0
    wanted = {path.name: path.read_bytes() for path in (tmp_path / "whole").iterdir()}
    cut = tmp_path / "cut"
    started = subprocess.Popen([sys.executable, "-m", "farfield.cli", *command, str(cut)], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not list(cut.glob("*.txt")) and time.monotonic() < deadline and started.poll() is None:
        time.sleep(0.001)
    started.kill()
    started.wait()
    assert list(cut.glob("*.txt"))
    assert all(path.read_bytes() == wanted[path.name] for path in cut.glob("*.txt"))
    assert cli.main([*command, str(cut)]) == 0
    assert {path.name: path.read_bytes() for path in cut.glob("*.txt")} == wanted


def few_frames(path: Path, frames: int, score: float = 0.7) -> Path:
    """Five cars that stand, in so many frames."""
    lines = ["frame,label,x,y,z,l,w,h,yaw_rad,score"]
    lines += [f"{frame},car,{20 + 9 * car},0,0,4,2,1.5,0,{score}" for frame in range(frames) for car in range(5)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_few_frames_say_how_many_hits_a_track_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["track", str(few_frames(tmp_path / "found.csv", 4)), "--out", str(tmp_path / "tracks.csv")]
    assert cli.main(words) == 0
    text = capsys.readouterr().out
    assert "20 of 20 detections are in no reported track: a track needs 3 hits (min_hits)" in text
    assert "with scores below 0.9 5 hits (unsure_hits)" in text
    assert "the shortest drive has 4 frames" in text
    assert cli.main([*words, "-o", "min_hits=1", "-o", "unsure_hits=1"]) == 0
    text = capsys.readouterr().out
    assert "5 tracks, 20 boxes" in text
    assert "hits" not in text


@pytest.mark.parametrize("words", [["--preset", "ab3dmot"], ["--preset", "centerpoint"], ["--smooth"]])
def test_every_preset_says_its_own_hits(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = few_frames(tmp_path / "found.csv", 2)
    assert cli.main(["track", str(path), "--out", str(tmp_path / "tracks.csv"), *words]) == 0
    text = capsys.readouterr().out
    assert ("detections are in no reported track" in text) == ("0 tracks" in text)


def test_long_drives_of_clear_tracks_need_no_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = few_frames(tmp_path / "found.csv", 30, score=0.95)
    assert cli.main(["track", str(path), "--out", str(tmp_path / "tracks.csv")]) == 0
    assert "hits" not in capsys.readouterr().out
