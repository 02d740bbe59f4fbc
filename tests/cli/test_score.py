"""``farfield score`` on files: the promised command lines, the JSON's layout, and clear refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.cli import main
from farfield.files.boxes_csv import BoxRows, write_boxes_csv

FEW = ["--replicates", "3"]
LABEL = "{frame} 0 Car 0 0 0 10 10 50 60 1.5 1.8 4.2 {x} 1.6 {z} -1.5707963267948966"


def rows(frames: int = 3, *, scored: bool = True, sequence: str | None = "drive", shift_m: float = 0.0) -> BoxRows:
    names = np.repeat([f"{i:03d}" for i in range(frames)], 2)
    centre = np.column_stack([np.tile([20.0, 90.0], frames) + shift_m, np.zeros(2 * frames), np.zeros(2 * frames)])
    return BoxRows(
        frame=names,
        label=np.tile(["vehicle", "large_vehicle"], frames),
        centre_m=centre,
        size_m=np.tile([4.0, 2.0, 1.5], (2 * frames, 1)),
        yaw_rad=np.zeros(2 * frames),
        sequence=None if sequence is None else np.full(2 * frames, sequence),
        score=np.linspace(0.2, 0.9, 2 * frames) if scored else None,
    )


def run(tmp_path: Path, *words: str | Path) -> dict[str, Any]:
    out = tmp_path / "out.json"
    assert main(["score", *map(str, words), "--json", str(out), *FEW]) == 0
    return json.loads(out.read_text())


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    write_boxes_csv(tmp_path / "p.csv", rows(shift_m=0.1))
    write_boxes_csv(tmp_path / "l.csv", rows(scored=False))
    return tmp_path / "p.csv", tmp_path / "l.csv"


def test_the_json_has_the_promised_layout(tmp_path: Path, files: tuple[Path, Path]) -> None:
    tree = run(tmp_path, *files)
    assert (tree["protocol"], tree["label"], tree["settings"]["region"]) == ("dds", "vehicle", "window")
    assert set(tree["ap"]) == {"0.5", "1.0", "2.0", "4.0"}
    assert set(tree["errors"]) == {"trans_err", "scale_err", "orient_err"}
    assert set(tree["dds"]) == {"0", "0.003", "0.006", "0.009"}
    assert set(tree["dds"]["0.003"]) == {"dds", "map", "aiou"}
    assert set(tree["ranges"]) == {"0-70", "70-150", "150-250"}
    assert tree["ranges"]["0-70"]["dds"]["0"]["dds"] == pytest.approx(1.0)
    assert tree["ranges"]["150-250"] is None
    assert tree["errors"]["trans_err"] == pytest.approx(0.1)
    assert tree["counts"]["annotated"] == 6  # vehicle and large_vehicle are one class


def test_flags_reach_the_settings(tmp_path: Path, files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--range-bins-m", "0,50,100", "--epsilons", "0.5", "--region", "range", "--label", "vehicle"]
    tree = run(tmp_path, *files, *words, "--options", "ap=area", "relabel=", "ignore=a,b", "aiou_threshold_m=all")
    settings = tree["settings"]
    assert (settings["range_bins_m"], settings["epsilons"], settings["region"]) == ([0.0, 50.0, 100.0], [0.5], "range")
    assert (settings["ap"], settings["relabel"], settings["ignore"]) == ("area", {}, ["a", "b"])
    assert settings["aiou_threshold_m"] == "all"
    assert tree["counts"]["annotated"] == 3
    assert "ap=area" in capsys.readouterr().out


def test_each_class_is_scored_where_none_is_named(tmp_path: Path, files: tuple[Path, Path]) -> None:
    tree = run(tmp_path, *files, "--options", "relabel=", "--protocol", "nuscenes")
    assert set(tree["labels"]) == {"vehicle", "large_vehicle"}
    assert tree["labels"][tree["label"]]["ap"] == tree["ap"]


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kitti"])
def test_annotated_against_annotated_is_one(tmp_path: Path, files: tuple[Path, Path], protocol: str) -> None:
    tree = run(tmp_path, files[1], files[1], "--protocol", protocol)
    assert any("no score" in note for note in tree["notes"])

    def leaves(value: Any) -> list[float]:
        return [leaf for v in value.values() for leaf in leaves(v)] if isinstance(value, dict) else [value]

    assert leaves(tree["ap"]) == pytest.approx(np.ones(len(leaves(tree["ap"]))), abs=1e-12)
    assert leaves(tree["dds"]) == pytest.approx(np.ones(len(leaves(tree["dds"]))), abs=1e-12)
    assert leaves(tree["errors"]) == pytest.approx(np.zeros(len(leaves(tree["errors"]))), abs=1e-12)


def test_folders_are_paired_by_stem(tmp_path: Path) -> None:
    for side, scored in (("p", True), ("l", False)):
        (tmp_path / side).mkdir()
        for stem in ("one", "two"):
            write_boxes_csv(tmp_path / side / f"{stem}.csv", rows(scored=scored, sequence=None))
    tree = run(tmp_path, tmp_path / "p", tmp_path / "l")
    assert tree["counts"]["frames"] == 6
    assert tree["intervals"]["resampled"] == "sequences"
    (tmp_path / "p" / "two.csv").unlink()
    tree = run(tmp_path, tmp_path / "p", tmp_path / "l")
    assert "1 of 2 label files" in tree["notes"][0]
    assert tree["counts"]["annotated"] == 12


def test_kitti_files_of_one_frame_each(tmp_path: Path) -> None:
    for side, score in (("p", " 0.7"), ("l", "")):
        (tmp_path / side).mkdir()
        for stem in ("000000", "000007"):
            line = LABEL.format(frame=0, x=2.0, z=30.0).split(" ", 2)[2]
            (tmp_path / side / f"{stem}.txt").write_text(f"{line}{score}\n")
    tree = run(tmp_path, tmp_path / "p", tmp_path / "l", "--format", "kitti", "--protocol", "kitti")
    assert tree["ap"]["3d_r40"] == {"easy": 1.0, "moderate": 1.0, "hard": 1.0}
    tree = run(tmp_path, tmp_path / "p", tmp_path / "l", "--format", "kitti")
    assert tree["dds"]["0"]["dds"] == pytest.approx(1.0)
    assert tree["settings"]["region"] == "none"


def test_predictions_in_frames_without_labels_are_false(tmp_path: Path) -> None:
    (tmp_path / "l.txt").write_text(LABEL.format(frame=0, x=2.0, z=30.0) + "\n")
    detection = "{frame},2,0,0,9,9,{score},1.5,1.8,4.2,{x},1.6,30.0,-1.5707963267948966,0\n"
    found = detection.format(frame=0, score=0.5, x=2.0) + detection.format(frame=4, score=0.9, x=2.0)
    (tmp_path / "p.txt").write_text(found)
    tree = run(tmp_path, tmp_path / "p.txt", tmp_path / "l.txt", "--format", "kitti-tracking")
    assert tree["counts"]["frames"] == 2
    assert tree["ap"]["2.0"] < 1.0
    assert "1 frame has predictions but no line of labels" in tree["notes"][0]


def test_the_camera_axes_are_turned(tmp_path: Path) -> None:
    from farfield.metrics.box_files import read

    (tmp_path / "l.txt").write_text(LABEL.format(frame=0, x=2.0, z=30.0) + "\n")
    (box,) = read(tmp_path / "l.txt", tmp_path / "l.txt", format="kitti-tracking").annotated.values()
    np.testing.assert_allclose(box.centre_m, [[30.0, -2.0, -1.6 + 0.75]])  # ahead, right of us, above the road
    np.testing.assert_allclose(box.size_m, [[4.2, 1.8, 1.5]])
    np.testing.assert_allclose(box.yaw_rad, [0.0], atol=1e-15)  # rotation_y of -pi/2 looks ahead


def test_the_promised_command_on_real_detections(tmp_path: Path, shared_real: Path) -> None:
    folder = shared_real / "kitti_tracking"
    expected = json.loads((folder / "expected_nuscenes.json").read_text())
    words = ["--protocol", "nuscenes", "--format", "kitti-tracking", "--label", "Car", "--options", "ties=later_first"]
    tree = run(tmp_path, folder / "detections_pointrcnn_car", folder / "label", *words)
    assert tree["ap"] == pytest.approx(expected["ap"], abs=1e-6)
    for name in ("trans_err", "scale_err", "orient_err"):
        assert tree["errors"][name] == pytest.approx(expected[f"{name}_2m"], abs=1e-6)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["p.csv", "missing.csv"], "found nothing there"),
        (["p.csv", "."], "one of each kind"),
        (["p.csv", "l.csv", "--label", "tram"], "expected an annotated class"),
        (["p.csv", "l.csv", "--range-bins-m", "0,far"], "comma-separated numbers"),
        (["p.csv", "l.csv", "--options", "ap"], "each name=value once"),
        (["p.csv", "l.csv", "--options", "colour=red"], "expected options among"),
        (["p.csv", "l.csv", "--options", "min_points=1.5"], "expected one number"),
        (["p.csv", "l.csv", "--options", "epsilons=1"], "flag of its own"),
        (["p.csv", "l.csv", "--format", "kitti"], "line 1"),
        (["p.csv", "other.csv"], "sequences that have labels"),
        (["p.csv", "renamed.csv"], "none in common"),
    ],
)
def test_wrong_words_end_with_one_line_and_status_1(
    tmp_path: Path, files: tuple[Path, Path], words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_boxes_csv(tmp_path / "other.csv", rows(scored=False, sequence="elsewhere"))
    renamed = rows(scored=False)
    write_boxes_csv(tmp_path / "renamed.csv", BoxRows(**{**vars(renamed), "frame": np.char.add("f", renamed.frame)}))
    words = [str(tmp_path / word) if word.endswith((".csv", ".")) and "=" not in word else word for word in words]
    assert main(["score", *words, "--replicates", "0"]) == 1
    assert said in capsys.readouterr().err
