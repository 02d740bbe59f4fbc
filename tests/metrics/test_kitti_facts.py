"""KITTI's rules need 2D boxes and occlusions: boxes without them are named with their number, or refused if all are."""

from pathlib import Path

import pytest

from farfield.cli import main
from farfield.errors import ConfigError
from farfield.metrics.box_files import read
from farfield.metrics.detections import PROTOCOLS

SEEN, NONE = "600 150 700 250", ("0 0 0 0", "-1 -1 -1 -1")


def folder(root: Path, pixels: list[str], score: str = "", *, occlusion: int = 0, label: str = "Car") -> Path:
    root.mkdir(parents=True)
    rows = [
        f"{label} 0 {occlusion} 0 {box} 1.6 1.9 4.5 3 1.7 {12 + 9 * row} -1.57{score}\n"
        for row, box in enumerate(pixels)
    ]
    (root / "000000.txt").write_text("".join(rows))
    return root


def score(tmp_path: Path, labels: list[str], results: list[str], **changes: int) -> tuple[str, ...]:
    paths = folder(tmp_path / "results", results, " 0.9"), folder(tmp_path / "labels", labels, **changes)
    detections = read(*paths, format="kitti")
    return PROTOCOLS["kitti"].evaluate(detections, PROTOCOLS["kitti"].Settings(label="Car")).notes


@pytest.mark.parametrize("none", NONE)
@pytest.mark.parametrize("side", ["annotated", "predicted"])
def test_some_boxes_without_a_2d_box_are_named_with_their_number(tmp_path: Path, none: str, side: str) -> None:
    some, all_seen = [SEEN, SEEN, none], [SEEN] * 3
    notes = score(tmp_path, *((some, all_seen) if side == "annotated" else (all_seen, some)))
    assert [note for note in notes if f"1 of 3 {side} boxes of 'Car' have no 2D box" in note]


@pytest.mark.parametrize("none", NONE)
@pytest.mark.parametrize("side", ["annotated", "predicted"])
def test_all_boxes_without_a_2d_box_are_refused(tmp_path: Path, none: str, side: str) -> None:
    sides = ([none] * 3, [SEEN] * 3)
    with pytest.raises(ConfigError, match=rf"2D box.*of {side} boxes.*all 3.*--protocol dds or nuscenes"):
        score(tmp_path, *(sides if side == "annotated" else sides[::-1]))


def test_where_no_occlusion_is_known_the_other_facts_make_the_difficulties(tmp_path: Path) -> None:
    notes = score(tmp_path, [SEEN] * 3, [SEEN] * 3, occlusion=3)
    (note,) = [note for note in notes if "occlusion" in note]
    assert "of all 3 annotated boxes is not known" in note
    assert "by height and truncation alone" in note


def test_some_boxes_of_unknown_occlusion_are_named_with_their_number(tmp_path: Path) -> None:
    paths = folder(tmp_path / "results", [SEEN] * 2, " 0.9"), folder(tmp_path / "labels", [SEEN] * 2)
    label = paths[1] / "000000.txt"
    label.write_text(label.read_text().replace("Car 0 0", "Car 0 3", 1))
    result = PROTOCOLS["kitti"].evaluate(read(*paths, format="kitti"), PROTOCOLS["kitti"].Settings(label="Car"))
    assert [note for note in result.notes if "1 of 2 annotated boxes of 'Car' have no known occlusion" in note]


def test_the_verb_exits_with_1_and_names_what_would_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = folder(tmp_path / "results", [SEEN], " 0.9"), folder(tmp_path / "labels", [NONE[0]])
    words = ["score", *map(str, paths), "--format", "kitti", "--label", "Car", "--replicates", "0"]
    assert main([*words, "--protocol", "kitti"]) == 1
    assert "--protocol dds" in capsys.readouterr().err
    assert main([*words, "--protocol", "dds"]) == 0


def test_one_class_without_2d_boxes_leaves_the_others_their_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labels, results = folder(tmp_path / "labels", [SEEN]), folder(tmp_path / "results", [SEEN], " 0.9")
    for path, end in ((labels, ""), (results, " 0.9")):
        text = f"Cyclist 0 0 0 0 0 0 0 1.6 0.6 1.8 -3 1.7 12 -1.57{end}\n"
        (path / "000000.txt").write_text((path / "000000.txt").read_text() + text)
    words = ["score", str(results), str(labels), "--format", "kitti", "--protocol", "kitti", "--replicates", "0"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "1 of 1 annotated boxes of 'Cyclist' have no 2D box" in out
    assert main([*words, "--label", "Cyclist"]) == 1
