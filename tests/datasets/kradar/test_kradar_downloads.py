"""K-Radar's downloads in their archives' form: two sequences, one archive empty, one cut; signals at ten moments."""

import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from drive import frame

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.downloads import content_of
from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.datasets.kradar.downloads import (
    convert_downloads,
    find_downloads,
    plan_downloads,
    stored_bytes,
    unpacked_path,
)
from farfield.datasets.kradar.layout import product_path
from farfield.datasets.kradar.store import StoreSettings, StoreTask, convert_to_store
from farfield.errors import DatasetError
from farfield.files.marks import mark_of

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
SETTINGS = StoreSettings(region="narrow")
FRAMES = {"1": 4, "58": 3}


def pack(path: Path, root: Path, patterns: tuple[str, ...], *, below: str = "") -> None:
    """Pack some files of a tree, by their names from ``below`` on."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for pattern in patterns:
            for file in sorted(root.glob(pattern)):
                if file.is_file():
                    archive.write(file, file.relative_to(root / below).as_posix())


def archives_of(root: Path, folder: Path) -> Path:
    """A tree as K-Radar's users have its downloads: by modality, one empty, one cut, one with a page for a file."""
    folder.mkdir()
    pack(folder / "rdr_polar_3d.zip", root, ("rdr_polar_3d/*/*",))
    pack(folder / "1_meta.zip", root, ("1/info_calib/*", "1/info_label/*", "1/description.txt"), below="1")
    pack(folder / "58.zip", root, ("58/info_calib/*", "58/info_label/*", "58/description.txt", "58/os2-64/*"))
    pack(folder / "revised_labels.zip", root, ("kradar_revised_label*/**/*.txt",))
    pack(folder / "1_lpc.zip", root, ("1/os2-64/*",))
    (folder / "1_lpc.zip").write_bytes((folder / "1_lpc.zip").read_bytes()[:2000])
    (folder / "58_lpc.zip").write_bytes(b"")
    return folder


def names_alone(folder: Path) -> Path:
    """Archives of whose files only the names matter."""
    tree = folder / "tree"
    for name in ("rdr_polar_3d/1/polar3d_00033.npy", "7/radar_tesseract/tesseract_00268.mat", "1/description.txt",
                 "1/info_label/00033_00001.txt", "58/info_label/00006_00001.txt", "58/os2-64/os2-64_00001.pcd",
                 "1/os2-64/os2-64_00001.pcd", "58/info_calib/calib_radar_lidar.txt"):  # fmt: skip
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_bytes(b"x" * 3000)
    downloads = archives_of(tree, folder / "downloads")
    pack(downloads / "7_missing_tesseract.zip", tree, ("7/radar_tesseract/*",), below="7/radar_tesseract")
    return downloads


def test_what_lies_in_the_archives_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    downloads = names_alone(tmp_path)
    with pytest.raises(DatasetError) as caught:
        open_dataset(downloads)
    for words in ("rdr_polar_3d.zip: K-Radar polar maps (1 file", "1_lpc.zip: cut", "58_lpc.zip: an empty file",
                  "--to radar-store"):  # fmt: skip
        assert words in str(caught.value)
    assert main(["doctor", str(downloads)]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "3 archives cannot be used" in shown  # the cut, the empty one, the one without any file
    assert not [path for path in downloads.iterdir() if path.suffix != ".zip"]
    read = find_downloads([downloads])
    assert [(radar.sequence, radar.index, radar.source) for radar in read.radar] == [
        ("1", 33, "polar3d"),
        ("7", 268, "tesseract"),
    ]
    assert set(read.beside) == {
        "1/description.txt", "1/info_label/00033_00001.txt", "58/info_label/00006_00001.txt",
        "58/info_calib/calib_radar_lidar.txt",
    }  # fmt: skip
    (downloads / "other.zip").write_bytes((downloads / "58.zip").read_bytes())
    assert content_of(downloads / "other.zip").datasets == ("K-Radar",)


def test_a_dry_run_says_the_disk_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    downloads, store = names_alone(tmp_path), tmp_path / "store"
    assert main(["convert", str(downloads), str(store), "--to", "radar-store", "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "2 of 2 frames to convert" in shown
    assert "the disk needs about" in shown
    assert not store.exists()
    assert main(["convert", str(downloads), str(downloads), "--to", "radar-store"]) == 1
    assert "store" not in {path.name for path in tmp_path.iterdir()}


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root, rng = tmp_path_factory.mktemp("tree"), np.random.default_rng(8)
    polar = np.stack([rng.exponential(0.01, (256, 107, 37)), rng.uniform(-1.9, 1.8, (256, 107, 37))])
    writer = KRadarWriter(root, columns=512)
    for sequence, count in FRAMES.items():
        for number in range(1, count + 1):
            writer.write(frame(number, sequence=sequence, radar={"polar3d": polar * number}))
    writer.finish()
    return root


@pytest.mark.parametrize("keep", [False, True])
def test_the_disk_takes_what_was_announced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, keep: bool) -> None:
    tree, store, peak = tmp_path / "tree", tmp_path / "store", [0]
    folder = tree / "1" / "radar_zyx_cube"
    folder.mkdir(parents=True)
    for number in range(1, 9):
        (folder / f"cube_{number:05d}.mat").write_bytes(bytes(3_000_000))
    (tmp_path / "downloads").mkdir()
    pack(tmp_path / "downloads" / "1_rt.zip", tree, ("1/radar_zyx_cube/*",))

    def stored(task: StoreTask, target: Path, settings: StoreSettings) -> list[Path]:
        """In place of the conversion: a file as large as one of cells, when all that is needed lies there."""
        path = target / product_path("cells", task.sequence, task.index)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(int(stored_bytes(settings, task.source))))
        peak[0] = max(peak[0], sum(file.stat().st_size for file in store.rglob("*") if file.is_file()))
        return [path]

    monkeypatch.setattr("farfield.datasets.kradar.downloads.convert_frame", stored)
    monkeypatch.setattr("farfield.datasets.kradar.downloads.write_manifest", lambda *words: None)
    read = find_downloads([tmp_path / "downloads"])
    plan = plan_downloads(read, read.radar, StoreSettings(), workers=1, keep=keep)
    assert convert_downloads(read, store, keep=keep).written == 8
    assert abs(plan.peak_bytes - peak[0]) < 0.05 * peak[0]


def contents(store: Path) -> dict[str, tuple[int, int]]:
    return {path.relative_to(store).as_posix(): mark_of(path) for path in store.glob("radar_cells/*/*")}


@pytest.mark.slow
def test_a_store_of_the_archives_is_that_of_the_tree_and_opens_by_itself(tree: Path, tmp_path: Path) -> None:
    downloads = archives_of(tree, tmp_path / "downloads")
    marks = {path: (mark_of(path), path.stat().st_mtime_ns) for path in downloads.iterdir()}
    said: list[str] = []
    outcome = convert_downloads(find_downloads([downloads]), tmp_path / "store", SETTINGS, announce=said.append)
    assert (outcome.written, outcome.skipped) == (sum(FRAMES.values()), 0)
    assert any("1_lpc.zip: cut" in fault for fault in outcome.faults)
    assert "7 of 7 frames" in said[0]
    assert len(said) == 2
    assert "min" in said[1]
    convert_to_store(KRadar(tree), tmp_path / "plain", SETTINGS)
    assert contents(tmp_path / "store") == contents(tmp_path / "plain")
    for path in contents(tmp_path / "store"):
        size = (tmp_path / "store" / path).stat().st_size
        assert abs(stored_bytes(SETTINGS, "polar3d") - size) < 0.2 * size, path
    assert not (tmp_path / "store" / "unpacked").exists()
    assert {path: (mark_of(path), path.stat().st_mtime_ns) for path in downloads.iterdir()} == marks
    data = open_dataset(tmp_path / "store")
    assert len(data) == sum(FRAMES.values())
    assert data[0].conditions["weather"] == "light_snow"
    assert len(data[0].boxes or ())
    again = convert_downloads(find_downloads([downloads]), tmp_path / "store", SETTINGS)
    assert (again.written, again.skipped) == (0, 7)


@pytest.mark.slow
def test_a_damaged_member_is_said_and_the_next_archive_mends_it(tree: Path, tmp_path: Path) -> None:
    downloads = tmp_path / "downloads"
    downloads.mkdir()
    pack(downloads / "1_rt.zip", tree, ("rdr_polar_3d/1/*",))
    data = bytearray((downloads / "1_rt.zip").read_bytes())
    data[1_000_000] ^= 1  # of the first frame
    (downloads / "1_rt.zip").write_bytes(data)
    outcome = convert_downloads(find_downloads([downloads]), tmp_path / "store", SETTINGS)
    assert len(outcome.faults) == 1
    assert "1_rt.zip" in outcome.faults[0]
    assert len(contents(tmp_path / "store")) == FRAMES["1"] - 1
    pack(downloads / "1_missing.zip", tree, ("rdr_polar_3d/1/*",))
    mended = convert_downloads(find_downloads([downloads]), tmp_path / "store", SETTINGS)
    assert not mended.faults
    assert len(contents(tmp_path / "store")) == FRAMES["1"]


@pytest.mark.slow
def test_ten_signals_lose_nothing_and_unpack_nothing_twice(tree: Path, tmp_path: Path) -> None:
    downloads, store = archives_of(tree, tmp_path / "downloads"), tmp_path / "store"
    sources = {path: (mark_of(path), path.stat().st_mtime_ns) for path in downloads.iterdir()}
    command = [sys.executable, "-m", "farfield.cli", "convert", str(downloads), str(store), "--to", "radar-store",
               "--region", "narrow", "--workers", "1", "--keep"]  # fmt: skip
    frames = find_downloads([downloads]).radar
    whole: dict[Path, tuple[int, int]] = {}
    for moment in range(10):
        running = subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until, before = time.monotonic() + 300, len(contents(store))
        while running.poll() is None and time.monotonic() < until:
            begun = bool(list(store.glob("unpacked/*/*/.*.part"))) if moment % 3 == 0 else (
                len(list(store.glob("unpacked/rdr_polar_3d/*/*.npy"))) > len(whole)
                if moment % 3 == 1 else len(contents(store)) > before
            )  # fmt: skip
            if begun:
                break
            time.sleep(0.002)
        running.send_signal((signal.SIGKILL, signal.SIGTERM)[moment % 2])
        # -15: the interpreter was down already
        ends = ((-signal.SIGKILL, 0), (128 + signal.SIGTERM, -signal.SIGTERM, 0))[moment % 2]
        assert running.wait(60) in ends
        for radar in frames:
            path = unpacked_path(store, radar)
            if path.is_file():
                state = (path.stat().st_ino, path.stat().st_mtime_ns)
                assert whole.setdefault(path, state) == state, f"unpacked twice: {path.name}"
    assert subprocess.run(command, env=ENVIRONMENT, check=False).returncode == 0
    for path, state in whole.items():
        assert (path.stat().st_ino, path.stat().st_mtime_ns) == state
    convert_to_store(KRadar(tree), tmp_path / "plain", SETTINGS)
    assert contents(store) == contents(tmp_path / "plain")
    assert {path: (mark_of(path), path.stat().st_mtime_ns) for path in downloads.iterdir()} == sources
    assert not [path for path in store.rglob("*") if path.suffix in (".part", ".lock") or "unfinished" in path.name]
    finished = find_downloads([downloads])
    assert convert_downloads(finished, store, SETTINGS).skipped == sum(FRAMES.values())
    assert not list(store.glob("unpacked/**/*.npy"))
