"""``farfield compare-results``: tables of one convention, refusals that name the difference, columns kept apart."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield import cli
from farfield.geometry.boxes import Boxes
from farfield.metrics import Bootstrap, score

NONE = Bootstrap(replicates=0)


@pytest.fixture(autouse=True)
def verb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cli.VERBS, "compare-results", "set results side by side")


def scene(shift_m: float) -> tuple[dict[tuple[str, str], Boxes], dict[tuple[str, str], Boxes]]:
    predictions, annotations = {}, {}
    for number in range(50):
        centre = np.array([[20.0, 0, 0], [50.0, 2, 0]])
        size, label = np.tile([4.0, 2.0, 1.5], (2, 1)), ["vehicle", "large_vehicle"]
        yaw = np.zeros(2)
        key = (str(number % 2), str(number))
        annotations[key] = Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=label)
        predictions[key] = Boxes(
            centre_m=centre + np.array([shift_m, 0, 0]), size_m=size, yaw_rad=yaw, label=label, score=np.full(2, 0.5)
        )
    return predictions, annotations


def write(path: Path, shift_m: float = 0.0, *, frames: int = 50, **options: Any) -> str:
    predictions, annotations = ({key: side[key] for key in list(side)[:frames]} for side in scene(shift_m))
    if str(options.get("protocol", "")).startswith("kradar"):
        weather = {"0": "fog", "1": "rain"}
        options["conditions"] = {key: {"weather": weather[key[0]]} for key in annotations}
    tree = score(predictions, annotations, bootstrap=NONE, **options).to_json()
    path.write_text(json.dumps(tree))
    return str(path)


def run(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> str:
    assert cli.main(["compare-results", *words]) == status
    out, err = capsys.readouterr()
    return out if status == 0 else err


def test_results_of_one_convention_stand_in_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "rtnh.json", protocol="kradar")
    b = write(tmp_path / "rtn.json", 1.5, protocol="kradar", ious=(0.3, 0.5))
    out = run(capsys, a, b, "--label", "vehicle")
    lines = [line.split() for line in out.splitlines()]
    assert ["rtnh", "100.00", "100.00", "100.00", "100.00", "100.00", "100.00"] in lines
    assert ["rtn", "100.00", "0.00", "-", "100.00", "0.00", "-"] in lines  # IoU of 2.5 / 5.5
    assert "label_version=not stated; region=wide" in out
    assert "large_vehicle" not in out
    assert "note:" not in out
    assert "kradar, large_vehicle" in run(capsys, a, b)


def test_tables_by_weather_and_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", protocol="kradar")
    out = run(capsys, a, "--by", "weather", "--figures", "bev/0.5", "--label", "vehicle", "--names", "RTNH")
    assert "total  normal  overcast     fog    rain  sleet  light snow  heavy snow" in out
    row = next(line.split() for line in out.splitlines() if line.startswith("RTNH"))
    assert row == ["RTNH", "100.00", "-", "-", "100.00", "100.00", "-", "-", "-"]
    d = write(tmp_path / "d.json")
    out = run(capsys, d, "--by", "range", "--figures", "dds/0.003/map")
    assert out.splitlines()[4].split()[1:] == ["1.0000", "1.0000", "-", "-"]
    assert "none of the results has figures by weather" in run(capsys, d, "--by", "weather", status=1)


@pytest.mark.parametrize(
    ("protocol", "option", "words"),
    [
        ("dds", {"ap": "voc"}, "ap: nuscenes and voc"),
        ("nuscenes", {"distance": "3d"}, "distance: bev and 3d"),
        ("kitti", {"min_overlap": 0.5}, "min_overlap: 0.7 and 0.5"),
        ("kradar", {"score_cut": 0.3}, "score_cut: 0.0 and 0.3"),
        ("kradar", {"label_version": "v2.1"}, "label_version: not stated and v2.1"),
    ],
)
def test_different_conventions_are_refused_unless_kept_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], protocol: str, option: dict[str, Any], words: str
) -> None:
    a = write(tmp_path / "a.json", protocol=protocol, label="vehicle")
    b = write(tmp_path / "b.json", protocol=protocol, label="vehicle", **option)
    error = run(capsys, a, b, status=1)
    assert words in error
    assert "--separate" in error
    out = run(capsys, a, b, "--separate")
    assert "[A]" in out
    assert f"[B] {protocol}: " in out
    cells = {line.split()[0]: line for line in out.splitlines() if line[:2] in ("a ", "b ")}
    head = next(line for line in out.splitlines() if "[A]" in line and "[B]" in line)
    for letter, row in (("A", "a"), ("B", "b")):
        ends = [place + 3 for place in range(len(head)) if head.startswith(f"[{letter}]", place)]
        assert len(cells[row].split()) == 1 + len(ends)
        assert all(cells[row][end - 1].isdigit() for end in ends)


def test_protocols_and_variants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [
        write(tmp_path / "kradar.json", protocol="kradar"),
        write(tmp_path / "dds.json"),
        write(tmp_path / "kitti.json", protocol="kitti"),
        write(tmp_path / "nuscenes.json", protocol="nuscenes"),
    ]
    out = run(capsys, *files)
    assert [word in out for word in ("kradar, vehicle", "dds, vehicle", "kitti, vehicle", "nuscenes, vehicle")] == [
        True
    ] * 4
    old = write(tmp_path / "old.json", protocol="kradar-compat:old_as_shipped")
    assert "recall_points: 40 and 11" in run(capsys, files[0], old, status=1)
    assert "[B] kradar-compat:old_as_shipped" in run(capsys, files[0], old, "--separate")


def test_unequal_data_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", protocol="kradar")
    b = write(tmp_path / "b.json", protocol="kradar", frames=10)
    out = run(capsys, a, b, "--label", "vehicle")
    assert "note: not the same data. a: 50 frames, 50 annotated; b: 10 frames, 10 annotated" in out


def test_evaluations_and_several_classes_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = (json.loads(Path(write(tmp_path / "x.json", shift)).read_text()) for shift in (0.0, 0.1))
    both = a | {"labels": {"vehicle": a, "large_vehicle": b | {"label": "large_vehicle"}}}
    (tmp_path / "score.json").write_text(json.dumps(both))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "evaluation.json").write_text(json.dumps({"results": {"gaussian": a, "uniform": b}}))
    out = run(capsys, str(tmp_path / "score.json"), str(tmp_path / "run"), "--label", "vehicle")
    assert [line.split("  ")[0] for line in out.splitlines()[4:7]] == [
        "score",
        "run: gaussian",
        "run: uniform",
    ]
    assert "dds, large_vehicle" in run(capsys, str(tmp_path / "score.json"))


def test_what_is_wrong_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", protocol="kradar")
    for text in (
        "",
        "[1]",
        "{}",
        '{"protocol": "dds"}',
        '{"results": {"a": 1}}',
        "[" * 100_000,
        '{"protocol": 1, "settings": []}',
    ):
        (tmp_path / "bad.json").write_text(text)
        assert "expected" in run(capsys, str(tmp_path / "bad.json"), status=1)
    assert "found none there" in run(capsys, str(tmp_path / "none.json"), status=1)
    assert "3d/0.3" in run(capsys, a, "--figures", "3d/0.9", status=1)
    assert "expected one of vehicle, large_vehicle" in run(capsys, a, "--label", "boat", status=1)
    assert "as many names" in run(capsys, a, "--names", "x,y", status=1)


def test_the_papers_table_by_weather(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "rtnh.json", protocol="kradar")
    out = run(capsys, a, "--paper")
    ours, published = out.split("Published (Table 4)")
    assert "| rtnh | 100.0 | - | - | 100.0 | 100.0 | - | - | - |" in ours
    assert "kradar: label_version=not stated" in ours
    assert "| RTNH (4D radar) | 47.4 | 49.9 |" in published
    assert "labels v1.0, narrow region" in published
    by_time = run(capsys, a, "--paper", "--by", "time", "--figures", "bev/0.5", "--label", "large_vehicle")
    assert "|  | total | day | night |" in by_time
    assert "Published" not in by_time
    assert "figures: expected one of 3d/IOU" in run(capsys, a, "--paper", "--figures", "3d/0.9", status=1)
    assert "figures: expected one of 3d/IOU" in run(capsys, a, "--paper", "--figures", "3d/0.3", "bev/0.3", status=1)
    assert "kind: expected one of weather" in run(capsys, a, "--paper", "--by", "range", status=1)
    dds = write(tmp_path / "dds.json")
    assert "expected a result of kradar" in run(capsys, dds, "--paper", status=1)
