"""Clouds of five layouts through predict, doctor and convert: the same points give the same boxes, counts and files."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main

CARS = np.array([[12.0, 0.0, -1.2], [25.0, 4.0, -1.2], [40.0, -5.0, -1.2]])
POINTS = 4_000
HOLES = 500
LAYOUTS = ("five.bin", "turned.npy", "three.xyz", "four.xyz", "organised.pcd")


def rows() -> np.ndarray:
    """Ground and three cars: x, y, z in metres and an intensity."""
    random = np.random.default_rng(0)
    count = POINTS - 1_200
    ground = np.column_stack([random.uniform(3, 60, count), random.uniform(-12, 12, count), np.full(count, -2.0)])
    bodies = [random.uniform(-1, 1, (400, 3)) * [2.2, 0.9, 0.75] + place for place in CARS]
    return np.column_stack([np.concatenate([ground, *bodies]), random.uniform(0, 1, POINTS)]).astype(np.float32)


def write(path: Path) -> Path:
    """The points in the layout that the name says."""
    points = rows()
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.name == "five.bin":  # as nuScenes: intensity to 255, then the ring
        np.column_stack([points[:, :3], np.round(points[:, 3] * 255), np.arange(POINTS) % 32]).astype("<f4").tofile(
            path
        )
    elif path.name == "turned.npy":
        np.save(path, points.T)
    elif path.suffix == ".xyz":
        text = (" ".join(f"{value:.9g}" for value in row[: 3 if path.name == "three.xyz" else 4]) for row in points)
        path.write_text("\n".join(text) + "\n")
    else:
        filled = np.full((POINTS + HOLES, 4), np.nan, np.float32)
        filled[np.sort(np.random.default_rng(1).permutation(POINTS + HOLES)[:POINTS])] = points
        head = ["# .PCD v0.7", "VERSION 0.7", "FIELDS x y z intensity", "SIZE 4 4 4 4", "TYPE F F F F", "COUNT 1 1 1 1"]
        head += [f"WIDTH {(POINTS + HOLES) // 10}", "HEIGHT 10", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {POINTS + HOLES}"]
        path.write_bytes("\n".join([*head, "DATA binary", ""]).encode() + filled.tobytes())
    return path


def boxes(path: Path) -> dict[str, list[dict[str, str]]]:
    """Boxes by the stem of their frame's file."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in csv.DictReader(path.read_text("utf-8").splitlines()):
        found.setdefault(row.pop("frame"), []).append(row)
    return found


def test_predict_finds_the_same_in_each(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    np.save(tmp_path / "plain.npy", rows())
    files = [str(write(tmp_path / name)) for name in LAYOUTS]
    words = ["--precision", "fp32", "--score-threshold", "0.1", "--out", str(tmp_path / "found.csv")]
    assert main(["predict", "pointpillars-cirrus-sim", str(tmp_path / "plain.npy"), *files, *words]) == 0
    found = boxes(tmp_path / "found.csv")
    assert {*found} == {"plain", *(Path(name).stem for name in LAYOUTS)}
    assert found["plain"]
    for stem, each in found.items():
        assert [{**row, "sequence": ""} for row in each] == [{**row, "sequence": ""} for row in found["plain"]], stem


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_doctor_counts_them(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "own" / name)
    main(["doctor", str(tmp_path / "own"), "--json", "-"])
    report = json.loads(capsys.readouterr().out)
    assert report["facts"]["clouds"]["lidar"]["points"] == POINTS
    said = " ".join(f"{each['what']} {each['mend']}" for each in report["findings"])
    assert (f"{HOLES}" in said) == name.endswith(".pcd"), said
    assert ("5 columns" in said) == name.endswith(".bin"), said
    assert not [each for each in report["findings"] if each["severity"] == "fail" and "cloud" in each["topic"]]


@pytest.mark.parametrize("name", LAYOUTS)
def test_convert_writes_the_same_points(name: str, tmp_path: Path) -> None:
    write(tmp_path / "own" / name)
    assert main(["convert", str(tmp_path / "own"), str(tmp_path / "kitti"), "--to", "kitti"]) == 0
    (path,) = (tmp_path / "kitti" / "training" / "velodyne").glob("*.bin")
    written = np.fromfile(path, "<f4").reshape(-1, 4)
    assert np.array_equal(written[:, :3], rows()[:, :3])
    strong = np.zeros(POINTS) if name == "three.xyz" else rows()[:, 3]
    assert np.abs(written[:, 3] - strong).max() <= (0.5 / 255 + 1e-6 if name == "five.bin" else 1e-6)


class TestTheFlag:
    """What no number shows, such as noise, is refused until the flag says it; a wrong flag is refused too."""

    @pytest.fixture
    def noise(self, tmp_path: Path) -> Path:
        (tmp_path / "noise").mkdir()
        values = np.random.default_rng(1).normal(size=(500, 4)).astype("<f4")
        values.tofile(tmp_path / "noise" / "a.bin")
        return tmp_path / "noise"

    @pytest.mark.parametrize("verb", ["predict", "convert", "doctor", "evaluate", "stats", "show", "odometry", "adapt"])
    def test_decides_in_every_verb(
        self, verb: str, noise: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch
    ) -> None:
        if verb in ("predict", "evaluate", "adapt"):
            pytest.importorskip("torch")
        monkeypatch.chdir(tmp_path)
        before, after = {
            "predict": (["pointpillars-cirrus-sim"], ["--out", "found.csv", "--dry-run"]),
            "evaluate": (["pointpillars-cirrus-sim"], ["--dry-run"]),
            "adapt": (["pointpillars-cirrus-sim"], ["--dry-run"]),
            "convert": ([], ["kitti", "--to", "kitti"]),
            "odometry": ([], ["--dry-run"]),
        }.get(verb, ([], []))
        words = [verb, *before, "noise", *after]
        assert main(words) == 1 or verb == "odometry"  # which opens the clouds later
        said = "".join(capsys.readouterr())
        assert "--columns" in said or verb == "odometry", said
        status = main([*words, "--columns", "5"])
        said = "".join(capsys.readouterr())
        assert "--columns" not in said, said
        assert status == 0 or verb == "doctor", said

    @pytest.mark.parametrize("verb", ["stats", "doctor"])
    def test_is_refused_where_the_layout_has_no_such_files(
        self, verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        (tmp_path / "Cirrus_dataset1" / "dataset1_gaussian").mkdir(parents=True)
        (tmp_path / "Cirrus_dataset1" / "dataset1_gaussian" / "1600000000000000000.xyz").write_text("1 2 3 4 5\n" * 20)
        assert main([verb, str(tmp_path / "Cirrus_dataset1"), "--columns", "5"]) == 1
        said = capsys.readouterr().err
        assert "--columns" in said, said
