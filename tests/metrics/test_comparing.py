"""Results side by side are called by what they are of, and other data stand apart."""

import json
from dataclasses import replace
from pathlib import Path

from farfield.metrics import Bootstrap, Detections
from farfield.metrics.comparing import compare, read_results
from farfield.testing.protocols import example

NONE = Bootstrap(replicates=0)


def evaluation(folder: Path, found: Detections, protocol: str = "dds") -> Path:
    folder.mkdir()
    tree = {"results": {"lidar": found.score(protocol, bootstrap=NONE).to_json()}}
    (folder / "evaluation.json").write_text(json.dumps(tree))
    return folder


def of(detector: str, shift_m: float = 0.0) -> Detections:
    found = example()
    moved = {
        key: a.replaced(a.boxes.replace(centre_m=a.boxes.centre_m + shift_m)) for key, a in found.annotations.items()
    }
    return replace(found, annotations=moved, detector=detector, data="drives", fingerprint="ab" * 32, cloud="lidar")


def test_folders_are_read_and_rows_are_called_by_their_subject(tmp_path: Path) -> None:
    folders = [evaluation(tmp_path / name, of(name)) for name in ("pillars", "voxels")]
    entries = read_results(folders)
    assert [entry.name for entry in entries] == ["pillars on drives, lidar", "voxels on drives, lidar"]
    text = compare(entries).replace("\n  ", " ")
    for entry in entries:
        assert f"row {entry.name}: {entry.subject}" in text
    assert "note:" not in text
    assert "[B]" not in text


def test_moved_labels_do_not_share_a_column(tmp_path: Path) -> None:
    folders = [evaluation(tmp_path / "a", of("pillars")), evaluation(tmp_path / "b", of("pillars", 0.4))]
    entries = read_results(folders)
    assert [entry.name for entry in entries] == ["1: pillars on drives, lidar", "2: pillars on drives, lidar"]
    text = compare(entries)
    assert "DDS [A]" in text
    assert "DDS [B]" in text
    assert "note: not the same data" in text


def test_evaluations_from_before_are_called_by_their_folder(tmp_path: Path) -> None:
    folder = evaluation(tmp_path / "old", of("pillars"))
    tree = json.loads((folder / "evaluation.json").read_text())
    del tree["results"]["lidar"]["subject"]
    (folder / "evaluation.json").write_text(json.dumps(tree))
    new = evaluation(tmp_path / "new", of("pillars"))
    entries = read_results([folder / "evaluation.json", new])
    assert [entry.name for entry in entries] == ["old", "pillars on drives, lidar"]
    assert "[B]" not in compare(entries)
