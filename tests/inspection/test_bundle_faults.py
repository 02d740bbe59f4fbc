"""Faults that are planted in copies of real sets and of simulated trees, each told by the bundle of the copy alone."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from drive import frame
from test_doctor_bundle import bundle_of

from farfield.datasets.kradar import KRadarWriter
from farfield.inspection.bundle import bundle_findings, read_bundle

pytestmark = pytest.mark.slow
Plant = Callable[[Path], object]


def files(root: Path, glob: str) -> list[Path]:
    """Files of a copy; there are some."""
    paths = sorted(root.glob(glob))
    assert paths, glob
    return paths


def five_columns(root: Path) -> None:
    """A sweep with a column more than the others."""
    path = files(root, "training/velodyne/*.bin")[2]
    points = np.fromfile(path, dtype="<f4").reshape(-1, 4)
    np.hstack([points, points[:, :1]])[: len(points) // 4 * 4 - 1].astype("<f4").tofile(path)


def column_less(glob: str, root: Path) -> None:
    """A text whose lines lost their last number."""
    path = files(root, glob)[1]
    path.write_text("".join(f"{line.rsplit(' ', 1)[0]}\n" for line in path.read_text().splitlines()))


def put(glob: str, old: str, new: str, root: Path, *, once: bool = False) -> None:
    """Other words in a file, or in all."""
    paths = [path for path in files(root, glob) if old in path.read_text()]
    assert paths, old
    for path in paths[:1] if once else paths:
        path.write_text(path.read_text().replace(old, new, 1 if once else -1))


def cut(glob: str, root: Path) -> None:
    """A file without its end."""
    path = files(root, glob)[-1]
    path.write_bytes(path.read_bytes()[: -max(7, path.stat().st_size // 9)])


def swap(glob: str, one: str, other: str, root: Path) -> None:
    """Two entries of all calibrations by each other's names."""
    for path in files(root, glob):
        text = path.read_text().replace(f"{one}:", "OTHER:").replace(f"{other}:", f"{one}:")
        path.write_text(text.replace("OTHER:", f"{other}:"))


def check(sound: Path, faulty: Path, plant: Plant, words: tuple[str, ...], folder: Path) -> None:
    """Plant a fault: the bundle of the copy tells it, that of the sound set does not."""
    plant(faulty)
    texts = []
    for name, root in (("sound", sound), ("faulty", faulty)):
        text = bundle_of(root, folder / f"{name}.json")
        assert str(root) not in text
        read = read_bundle(folder / f"{name}.json")
        texts.append({f"{finding.what} {finding.where}" for finding in bundle_findings(read)})
    told = [text for text in texts[1] - texts[0] if all(word in text for word in words)]
    assert told, texts[1] - texts[0]


REAL: dict[str, tuple[str, Plant, tuple[str, ...]]] = {
    "columns of a sweep": ("kitti_more", five_columns, ("columns",)),
    "columns of labels": ("kitti_more", partial(column_less, "training/label_2/*.txt"), ("14",)),
    "class of KITTI": ("kitti_more", partial(put, "training/label_2/*.txt", "Car ", "Cra "), ("'Cra'",)),
    "cut sweep": ("kitti_more", partial(cut, "training/velodyne/*.bin"), ("truncated",)),
    "swapped calibration": (
        "kitti_more",
        partial(swap, "training/calib/*.txt", "Tr_velo_to_cam", "Tr_imu_to_velo"),
        ("camera",),
    ),
    "negative stamps": (
        "radiate/tiny_foggy",
        partial(put, "Navtech_Polar.txt", "Time: 15", "Time: -15"),
        ("Navtech_Polar",),
    ),
    "class of RADIATE": ("radiate/tiny_foggy", partial(put, "annotations/*.json", '"bus"', '"buss"'), ("buss",)),
    "class of Cirrus": (
        "cirrus_layout/Cirrus_dataset1",
        partial(put, "*_annotation/*.json", '"vehicle"', '"vehicel"'),
        ("vehicel",),
    ),
    "columns of Astyx": (
        "astyx/dataset_astyx_hires2019",
        partial(column_less, "radar_6455/*.txt"),
        ("radar_6455/000006.txt", "expected X Y Z V_r Mag"),
    ),
    "cut cloud": ("sustechpoints", partial(cut, "lidar/*.pcd"), (".pcd",)),
}


@pytest.mark.parametrize("fault", list(REAL))
def test_a_fault_in_a_copy_of_a_real_set_is_told(tmp_path: Path, shared_real: Path, fault: str) -> None:
    name, plant, words = REAL[fault]
    if not (shared_real / name).is_dir():
        pytest.skip(f"no {name}")
    faulty = shutil.copytree(shared_real / name, tmp_path / "faulty")
    check(shared_real / name, faulty, plant, words, tmp_path)


@pytest.fixture(scope="module")
def kradar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A K-Radar tree of the writer; no real file was seen."""
    root = tmp_path_factory.mktemp("kradar")
    writer = KRadarWriter(root, columns=512)
    for number in range(1, 6):
        writer.write(frame(number))
    writer.finish()
    return root


KRADAR: dict[str, tuple[Plant, tuple[str, ...]]] = {
    "class": (partial(put, "**/*_*.txt", "Sedan", "Sedna"), ("Sedna",)),
    "cut sweep": (partial(cut, "1/os2-64/*.pcd"), (".pcd",)),
    "columns of labels": (partial(column_less, "1/info_label/*.txt"), ("lines of", "info_label")),
}


@pytest.mark.parametrize("fault", list(KRADAR))
def test_a_fault_in_a_written_kradar_tree_is_told(tmp_path: Path, kradar: Path, fault: str) -> None:
    plant, words = KRADAR[fault]
    check(kradar, shutil.copytree(kradar, tmp_path / "faulty"), plant, words, tmp_path)


def misnamed(root: Path) -> None:
    """A class that is misspelt in one simulated frame."""
    path = next(path for path in files(root, "**/*_annotation/*.json") if "vehicle" in path.read_text())
    tree = json.loads(path.read_text())
    tree["labels"][0]["label_class"] = "vehcile"
    path.write_text(json.dumps(tree))


def negative_stamp(root: Path) -> None:
    """A frame whose files bear a negative time."""
    paths = files(root, "**/*.xyz")
    stem = paths[0].stem
    for path in files(root, f"**/{stem}.*"):
        path.rename(path.with_name(f"-{path.name}"))


CIRRUS: dict[str, tuple[Plant, tuple[str, ...]]] = {
    "class": (misnamed, ("vehcile",)),
    "cut sweep": (partial(cut, "**/*_gaussian/*.xyz"), (".xyz",)),
    "negative stamps": (negative_stamp, ("-",)),
}


@pytest.mark.parametrize("fault", list(CIRRUS))
def test_a_fault_in_a_simulated_cirrus_tree_is_told(tmp_path: Path, simulated_cirrus: Path, fault: str) -> None:
    plant, words = CIRRUS[fault]
    check(simulated_cirrus, shutil.copytree(simulated_cirrus, tmp_path / "faulty"), plant, words, tmp_path)
