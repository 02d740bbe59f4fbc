"""K-Radar on the authors' disks: every verb opens the disks' folder, one disk, and one sequence of it alike."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from drive import frame

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.datasets.kradar.index import with_disks
from farfield.datasets.kradar.label_format import KRadarLabelFormat
from farfield.datasets.kradar.layout import POLAR_RATES
from farfield.datasets.kradar.products import write_radar
from farfield.evaluation.ground_truth import read_detections

ROOTS = (".", "dir_1to20", "dir_1to20/1")


def _write(root: Path) -> None:
    for disk, sequence, lead in (("dir_1to20", "1", 32), ("dir_21to37", "25", -1)):
        writer = KRadarWriter(root / disk, columns=512)
        for number in (2, 3, 4):
            writer.write(frame(number, sequence=sequence, lead=lead))
        writer.finish()


@pytest.fixture
def disks(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    return made_once("kradar-disks", _write)


@pytest.mark.parametrize("root", ROOTS)
def test_frames_are_those_of_the_folder(root: str, disks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = open_dataset(disks / root)
    assert isinstance(data, KRadar)
    assert set(data.sequences) == ({"1", "25"} if root == "." else {"1"})
    assert [len(one.boxes) for one in data] == [5] * len(data)
    assert [len(one.cloud("os2-64")) for one in data] == [900] * len(data)
    monkeypatch.chdir(disks / root)
    assert open_dataset(".").keys == data.keys
    edited = KRadarLabelFormat(data)
    assert [edited.path(key).is_file() for key in data.keys] == [True] * len(data)


def detections(root: Path, folder: Path) -> tuple[Path, int]:
    """The boxes of a tree as detections, and how many there are."""
    assert main(["convert", str(root), str(folder / "boxes.csv"), "--to", "boxes-csv"]) == 0
    with (folder / "boxes.csv").open(newline="") as handle:
        rows = [row | {"score": "0.9"} for row in csv.DictReader(handle)]
    with (folder / "found.csv").open("w", newline="") as handle:
        writer = csv.DictWriter(handle, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return folder / "found.csv", len(rows)


@pytest.mark.parametrize("root", ROOTS)
def test_boxes_are_converted_and_are_the_truth_of_scores(root: str, disks: Path, tmp_path: Path) -> None:
    path, count = detections(disks / root, tmp_path)
    assert sum(map(len, read_detections(path, disks / root).boxes.values())) == count


@pytest.mark.slow
@pytest.mark.parametrize("root", ROOTS)
def test_verbs_open_it(root: str, disks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = str(disks / root)
    detections(disks / root, tmp_path)
    for words in (
        ["doctor", folder],
        ["score", "found.csv", folder, "--protocol", "kradar", "--region", "none", "--replicates", "0"],
        ["stats", folder, "--out", "stats", "--workers", "1"],
        ["show", folder, "--out", "frame.png", "--cloud", "os2-64"],
        ["view", folder, "--html", "page.html", "--frame", "0"],
        ["train", "rtnh-kradar-sim", "-o", f"data.path={folder}", "--dry-run"],
        ["evaluate", "pointpillars-cirrus-sim", folder, "--clouds", "os2-64", "--dry-run"],
        ["predict", "pointpillars-cirrus-sim", folder, "--cloud", "os2-64", "--dry-run"],
        ["track", "found.csv", "--data", folder, "--out", "tracks.csv"],
        ["sync", folder, "--to", "os2-64", "--out", "sync"],
        ["odometry", folder, "--cloud", "os2-64", "--out", "odometry"],
        ["adapt", "pointpillars-cirrus-sim", folder, "--dry-run"],
    ):
        assert main(words) == (1 if words[0] == "doctor" else 0), words  # whose boxes lie anywhere


def test_containers_and_every_density_stand_where_the_kit_puts_them(tmp_path: Path) -> None:
    densities = {"pc1p": 2, "pc5p": 4, "pc10p": 6, "pc15p": 8, "pc20p": 10, "pc30p": 12}
    for name, count in densities.items():
        folder = tmp_path / "rdr_pc" / name / "4"
        folder.mkdir(parents=True)
        np.save(folder / "rpc_00050.npy", np.full((count, 11 if count == 8 else 5), 1.5))
    (tmp_path / "dir_sp_rdr_cube/sp_rdr_cube_corridor/4").mkdir(parents=True)
    np.save(tmp_path / "dir_sp_rdr_cube/sp_rdr_cube_corridor/4/spcube_00050.npy", np.ones((3, 4)))
    (tmp_path / "dir_1to20/4/radar_ra").mkdir(parents=True)
    data = open_dataset(tmp_path)
    assert (data.name, data.keys) == ("kradar", (("4", "00050_00009"),))
    assert {len(data[0].radar[name]) for name in POLAR_RATES} == set(densities.values())
    assert len(data[0].radar["corridor"]) == 3
    assert any("radar_ra/ is not read" in note for note in data.notes)
    (tmp_path / "dir_sp_rdr_cube/sp_rdr_cube_corridor/4/spcube_00050.npy").unlink()
    for rate, count in ((0.05, 4), (0.1, 6), (0.2, 10), (0.5, 12)):
        assert len(open_dataset(tmp_path, radar_rate=rate, radar_region="cube")[0].cloud("radar")) == count


def test_a_foreign_folder_of_a_number_is_no_sequence(tmp_path: Path) -> None:
    (tmp_path / "1" / "pictures").mkdir(parents=True)
    assert with_disks([tmp_path / "1"]) == (tmp_path / "1",)


def test_a_density_of_another_shape_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "pc15p" / "4"
    folder.mkdir(parents=True)
    np.save(folder / "rpc_00050.npy", np.ones((4, 7)))
    with pytest.raises(Exception, match=r"shape \(4, 5\)"):
        open_dataset(tmp_path)[0].radar["polar_cloud_15p"]
    write_radar(folder / "rpc_00050.npy", "polar_cloud_15p", np.ones((4, 5)))
    assert open_dataset(tmp_path)[0].radar["polar_cloud_15p"].shape == (4, 5)
