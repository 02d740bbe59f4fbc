"""Bundles: what they say, what they keep to themselves, and planted faults found from them alone."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from farfield.cli.doctor import run
from farfield.datasets import open_dataset
from farfield.errors import FarfieldError, FileFormatError
from farfield.inspection.bundle import MAX_BUNDLE_BYTES, bundle_findings, make_bundle, read_bundle, write_bundle
from farfield.inspection.bundle.listing import group_of
from farfield.inspection.doctor import examine
from farfield.inspection.single_file import examine_file

FRAMES = ("000010", "000011", "000012", "000013")
CALIB = "".join(f"P{row}: 700 0 600 0 0 700 180 0 0 0 1 0\n" for row in range(4)) + (
    "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\nTr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n"
)
LABEL = "Car 0.00 0 0.1 500 150 700 300 1.5 1.7 4.2 1.0 1.7 15.0 0.1\n"


def tree(root: Path) -> Path:
    """Four frames in KITTI's folders."""
    rng = np.random.default_rng(5)
    for folder in ("velodyne", "calib", "label_2"):
        (root / "training" / folder).mkdir(parents=True)
    for frame in FRAMES:
        points = rng.uniform((5, -10, -2, 0), (40, 10, 1, 1), (200, 4)).astype("<f4")
        (root / "training" / "velodyne" / f"{frame}.bin").write_bytes(points.tobytes())
        (root / "training" / "calib" / f"{frame}.txt").write_text(CALIB)
        (root / "training" / "label_2" / f"{frame}.txt").write_text(LABEL)
    return root


def bundle_of(root: Path, target: Path, *, masked: bool = False) -> str:
    """Write the bundle of a folder, whatever stands there; its text."""
    dataset = report = None
    error = ""
    try:
        dataset = open_dataset(root)
        report = examine(dataset)
    except FarfieldError as caught:
        error = str(caught)
    size = write_bundle(target, make_bundle(root, dataset, report, error=error, masked=masked))
    assert size == target.stat().st_size <= MAX_BUNDLE_BYTES
    return target.read_text("utf-8")


def cut_cloud(root: Path) -> None:
    path = root / "training" / "velodyne" / "000012.bin"
    path.write_bytes(path.read_bytes()[:-7])


def wrong_calibration(root: Path) -> None:
    path = root / "training" / "calib" / "000011.txt"
    path.write_text(CALIB.replace("P2: 700 0 600 0 0 700 180 0 0 0 1 0", "P2: 700 0 600 0 700 180 0 0 1"))


def lost_labels(root: Path) -> None:
    (root / "training" / "label_2" / "000013.txt").unlink()


def a_page(root: Path) -> None:
    (root / "training" / "velodyne" / "000010.bin").write_bytes(b"<!DOCTYPE html><html>Log in</html>")


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (cut_cloud, ("000012.bin", "truncated")),
        (wrong_calibration, ("000011.txt", "P2 9")),
        (lost_labels, ("label_2", "only in", "000013")),
        (a_page, ("000010.bin", "a page in HTML")),
    ],
)
def test_a_planted_fault_is_found_from_the_bundle_alone(
    tmp_path: Path, plant: Callable[[Path], None], words: tuple[str, ...]
) -> None:
    sound = tree(tmp_path / "sound")
    faulty = shutil.copytree(sound, tmp_path / "faulty")
    plant(faulty)
    bundle_of(sound, tmp_path / "sound.json")
    bundle_of(faulty, tmp_path / "faulty.json")
    shutil.rmtree(faulty)
    before, after = (
        [f"{finding.what} {finding.where}" for finding in bundle_findings(read_bundle(tmp_path / name))]
        for name in ("sound.json", "faulty.json")
    )
    hits = [text for text in after if all(word in text for word in words)]
    assert hits, after
    assert not [text for text in before if all(word in text for word in words)]


def test_a_bundle_names_no_place_of_the_machine_and_masks_names_on_demand(tmp_path: Path) -> None:
    root = tree(tmp_path / "home" / "a_customer")
    cut_cloud(root)
    text = bundle_of(root, tmp_path / "open.json")
    assert str(tmp_path) not in text
    assert "a_customer" not in text
    assert "000012.bin" in text
    masked = bundle_of(root, tmp_path / "masked.json", masked=True)
    assert not [frame for frame in FRAMES if frame in masked]
    assert "velodyne" in masked
    assert "truncated" in masked
    bundle = read_bundle(tmp_path / "masked.json")
    assert bundle.masked
    named = [fault.file for group in bundle.groups for fault in group.faults]
    assert named
    assert any(named[0] in finding.what for finding in bundle_findings(bundle) if finding.topic == "damaged")


def test_no_number_of_the_data_is_in_a_bundle_but_ranges(tmp_path: Path) -> None:
    root = tree(tmp_path / "set")
    (root / "oxts").mkdir()
    (root / "oxts" / "000010.txt").write_text("49.011234567 8.422987654 112.8 " + "0.123456 " * 27 + "\n")
    text = bundle_of(root, tmp_path / "b.json")
    assert "49.0112" not in text
    assert "8.4229" not in text
    assert "30 columns" in text
    clouds = [np.fromfile(path, dtype="<f4").reshape(-1, 4) for path in sorted(root.glob("training/velodyne/*.bin"))]
    limits = {*np.concatenate([[c.min(0), c.max(0)] for c in clouds]).ravel().tolist()}  # ranges may be told
    numbers = {*np.concatenate(clouds).ravel().tolist()} - limits
    assert not [number for number in numbers if repr(number) in text]


def test_what_cannot_be_opened_has_a_bundle_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "folder"
    root.mkdir()
    np.save(root / "odd.npy", np.zeros((2, 3, 4)))
    (root / "notes.docx").write_bytes(b"words")
    with pytest.raises(FarfieldError):
        run(root / "notes", bundle=tmp_path / "none.json")
    assert not (tmp_path / "none.json").exists()
    (root / "odd.npy").rename(root / "odd.array")
    with pytest.raises(FarfieldError):
        run(root, bundle=tmp_path / "b.json")
    capsys.readouterr()
    assert run(tmp_path / "b.json") == 1
    shown = capsys.readouterr().out
    assert "recognised no data set" in shown
    assert str(tmp_path / "folder") not in shown


def test_the_verb_writes_reads_back_and_takes_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tree(tmp_path / "set")
    run(root, bundle=tmp_path / "b.json", frames=1)
    assert "Read it before you send it" in capsys.readouterr().err
    json_path = tmp_path / "out.json"
    run(tmp_path / "b.json", json=json_path)
    assert "a bundle of kitti" in capsys.readouterr().out
    groups = json.loads(json_path.read_text())["facts"]["groups"]
    assert {group["folder"]: group["files"] for group in groups} == {
        f"training/{name}": 4 for name in ("velodyne", "calib", "label_2")
    }
    assert run(root / "training" / "label_2" / "000010.txt") == 0
    assert "labels of KITTI's objects" in capsys.readouterr().out
    cut_cloud(root)
    assert run(root / "training" / "velodyne" / "000012.bin") == 1
    assert "truncated" in capsys.readouterr().out


def test_one_file_shows_which_expectation_fails(tmp_path: Path) -> None:
    wrong_calibration(root := tree(tmp_path / "set"))
    report = examine_file(root / "training" / "calib" / "000011.txt")
    assert any("calibration of KITTI's objects" in f.what and "P2" in f.what for f in report.findings)
    (tmp_path / "x.rar").write_bytes(b"Rar!")
    assert examine_file(tmp_path / "x.rar").failed
    np.save(tmp_path / "polar3d_00001.npy", np.zeros((2, 256, 107, 36)))
    told = str(examine_file(tmp_path / "polar3d_00001.npy"))
    assert "(2, 256, 107, 37)" in told


def test_a_bundle_is_hostile_until_read(tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    for text in ('{"farfield_bundle": 1, "groups": 7}', '{"farfield_bundle": 2}', '{"farfield_bundle": 1', "[]"):
        path.write_text(text)
        with pytest.raises(FileFormatError):
            read_bundle(path)
    path.write_text('{"farfield_bundle": 1, "remarks": ["' + "x" * MAX_BUNDLE_BYTES + '"]}')
    with pytest.raises(FileFormatError, match="at most"):
        read_bundle(path)


def test_a_large_listing_is_cut_to_the_size(tmp_path: Path) -> None:
    one = group_of("a", ".txt", [tree(tmp_path / "set") / "training" / "calib" / "000010.txt"])
    bundle = make_bundle(tmp_path / "set", None, None)
    wide = one.model_copy(update={"folder": "f" * 2000})
    size = write_bundle(tmp_path / "b.json", bundle.model_copy(update={"groups": (wide,) * 600}))
    assert size <= MAX_BUNDLE_BYTES
    assert "for the file's size" in read_bundle(tmp_path / "b.json").left_out[0]


REAL = (
    "astyx/dataset_astyx_hires2019", "cirrus_layout", "kitti", "kitti_more", "kitti_raw", "kitti_tracking", "kradar",
    "argoverse2", "argoverse2_tracks", "boreas_objects", "pandaset", "pcd", "radiate", "sustechpoints", "time",
    "tj4dradset", "view_of_delft/lidar", "view_of_delft/radar",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_the_bundles_of_real_sets_are_read_back(tmp_path: Path, shared_real: Path, name: str) -> None:
    root = shared_real / name
    if not root.is_dir():
        pytest.skip(f"no {name}")
    text = bundle_of(root, tmp_path / "b.json", masked=name == "radiate")
    assert str(shared_real) not in text
    assert f"{Path.home()}/" not in text
    bundle = read_bundle(tmp_path / "b.json")
    assert bundle.groups
    assert bool(bundle.error) != bool(bundle.format)
