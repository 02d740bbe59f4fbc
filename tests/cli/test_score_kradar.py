"""``farfield score --protocol kradar`` on files of boxes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import farfield as ff
from farfield.cli import main
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.metrics import Bootstrap


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    """Sedans and buses of two sequences in the os2-64's frame, found a metre too far ahead."""
    for name, scored, shift_m in (("p.csv", True, 1.0), ("l.csv", False, 0.0)):
        frames = np.repeat(np.arange(40), 2)
        rows = BoxRows(
            sequence=np.where(frames < 20, "1", "58"),
            frame=np.array([f"{number:05d}_00001" for number in frames]),
            label=np.tile(["Sedan", "Bus or Truck"], 40),
            centre_m=np.tile([[15.0, 3.0, 0.0], [73.5, -2.0, 0.0]], (40, 1)) + np.array([shift_m, 0, 0]),
            size_m=np.tile([4.0, 2.0, 1.5], (80, 1)),
            yaw_rad=np.zeros(80),
            score=np.tile([0.9, 0.2], 40) if scored else None,
        )
        write_boxes_csv(tmp_path / name, rows)
    return str(tmp_path / "p.csv"), str(tmp_path / "l.csv")


def run(tmp_path: Path, *words: str) -> dict[str, Any]:
    out = tmp_path / "out.json"
    assert main(["score", *words, "--json", str(out), "--replicates", "0"]) == 0
    return json.loads(out.read_text())


def test_both_classes_and_the_conditions_are_scored(
    tmp_path: Path, files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--options", "boxes_in=os2-64", "--label-version", "v2.1", "--conditions", "published")
    tree = run(tmp_path, *files, "--protocol", "kradar", *words)
    assert tree["ap"]["vehicle"]["bev"] == {"0.3": 1.0, "0.5": 1.0, "0.7": 0.0}  # IoU 0.6
    assert tree["ap"]["large_vehicle"]["bev"]["0.5"] == 1.0  # 73.5 m from the os2-64 is 70.96 m from the radar
    assert tree["conditions"]["weather"]["heavy_snow"]["ap"]["vehicle"]["3d"]["0.3"] == 1.0
    assert tree["conditions"]["weather"]["fog"] is None
    assert tree["counts"]["conditions"]["time"]["night"]["frames"] == 20
    shown = capsys.readouterr().out
    for part in ("label_version=v2.1", "weather: heavy_snow", "road: university", "yaw=correct"):
        assert part in shown


def test_the_function_scores_by_condition_as_the_verb_does(tmp_path: Path, files: tuple[str, str]) -> None:
    words = ("--label-version", "v2.1", "--conditions", "published")
    tree = run(tmp_path, *files, "--protocol", "kradar", *words)
    no_intervals = Bootstrap(replicates=0)
    result = ff.score(
        *files, protocol="kradar", conditions="published", label_version="v2.1", bootstrap=no_intervals
    ).to_json()
    assert result["conditions"] == tree["conditions"]
    assert result["ap"] == tree["ap"]


def test_a_variant_turns_boxes_and_cuts_scores(tmp_path: Path, files: tuple[str, str]) -> None:
    words = ("--region", "none", "--label-version", "v2.0")
    tree = run(tmp_path, *files, "--protocol", "kradar-compat:old_as_shipped@0.3", *words)
    assert tree["protocol"] == "kradar-compat:old_as_shipped@0.3"
    assert tree["ap"]["vehicle"]["bev"] == {"0.3": pytest.approx(10 / 11), "0.5": 0.0, "0.7": 0.0}  # IoU 1/3, 40 boxes
    assert tree["ap"]["large_vehicle"]["bev"]["0.3"] == 0.0
    assert tree["counts"]["predictions_cut"] == 40
    assert tree["settings"]["region"] == "none"


def test_flags_and_tables_of_conditions(tmp_path: Path, files: tuple[str, str]) -> None:
    table = tmp_path / "conditions.csv"
    table.write_text("sequence,road,time,weather\n1,urban,night,sleet\n")
    words = ("--region", "0,100,-16,16,-2,8", "--label", "Sedan", "--range-bins-m", "0,30", "--conditions", str(table))
    options = ("azimuth_deg=none", "ious=0.4", "decimals=2", "recall_points=11", "score_cut=0.1")
    tree = run(tmp_path, *files, "--protocol", "kradar", *words, "--options", *options)
    settings = tree["settings"]
    assert (settings["classes"], settings["region"], settings["ious"]) == (["vehicle"], [0, 100, -16, 16, -2, 8], [0.4])
    assert (settings["azimuth_deg"], settings["decimals"], settings["recall_points"]) == (None, 2, 11)
    assert list(tree["ranges"]) == ["0-30"]
    assert tree["conditions"]["weather"]["sleet"]["ap"]["vehicle"]["3d"]["0.4"] == 1.0
    assert any("no conditions for sequences 58" in note for note in tree["notes"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--protocol", "kradar-compat:new"), "old_yaw_fixed"),
        (("--protocol", "kradar", "--region", "window"), "narrow, wide, none"),
        (("--protocol", "kradar", "--label", "boat"), "expected annotated boxes of boat"),
        (("--protocol", "kradar", "--conditions", "nothing.csv"), "found nothing"),
        (("--protocol", "kradar-compat:old_yaw_fixed", "--options", "score_cut=0.5"), "fixes score_cut"),
        (("--protocol", "kradar", "--options", "recall_points=1.5"), "expected one number"),
        (("--protocol", "kradar", "--options", "label_version=v2.1"), "flag of its own"),
        (("--protocol", "dds", "--conditions", "published"), "only kradar"),
        (("--protocol", "coco"), "one of dds"),
    ],
)
def test_what_is_impossible_is_refused(
    files: tuple[str, str], words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", *files, *words]) == 1
    assert message in capsys.readouterr().err
