"""A folder is listed once for all formats, and the listing answers as the disk does."""

import os
import pickle
from collections import Counter
from pathlib import Path

import pytest

from farfield.datasets import listing, recognise
from farfield.datasets.listing import ListedPath, listed_once

PATTERNS = (
    "*", "*.pcd", "*.[pP][cC][dD]", "velodyne/*.bin", "*/velodyne/*", "velodyne", "velodyne/0.bin", "v1.*", "*/*/deep",
    "frame_*.laz", "nothing/*", "a*/x?.[tT][xX][tT]", "*_[0-9].pcd", "*/", "link*/*", "lost*", "**/deep",
)  # fmt: skip


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Files, folders, hidden ones, links that lead on, nowhere and in a circle."""
    for name in (
        "0.pcd",
        "1_1.PCD",
        ".hidden.pcd",
        "velodyne/0.bin",
        "ab/x1.TXT",
        "ab/velodyne/deep",
        "v1.0-mini/t.json",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    (tmp_path / "link").symlink_to(tmp_path / "velodyne")
    (tmp_path / "lost").symlink_to(tmp_path / "nowhere")
    (tmp_path / "round").symlink_to(tmp_path / "round")
    return tmp_path


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_give_what_the_disk_gives(tree: Path, pattern: str) -> None:
    expected = sorted(map(str, tree.glob(pattern)))
    with listed_once():
        assert sorted(map(str, ListedPath(tree).glob(pattern))) == expected
    assert sorted(map(str, ListedPath(tree).glob(pattern))) == expected


def test_entries_are_what_the_disk_has(tree: Path) -> None:
    for folder in (tree, tree / "velodyne", tree / "link"):
        plain = {path.name: (path.is_dir(), path.is_file()) for path in folder.iterdir()}
        with listed_once():
            assert {p.name: (p.is_dir(), p.is_file()) for p in ListedPath(folder).iterdir()} == plain
    with listed_once(), pytest.raises(FileNotFoundError):
        list(ListedPath(tree / "none").iterdir())
    assert pickle.loads(pickle.dumps(ListedPath(tree))) == tree


def test_recognition_lists_a_folder_a_few_times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It listed it about fifty times."""
    (tmp_path / "notes.txt").write_text("nothing that is read")
    recognise(tmp_path)  # imports what it needs
    counts: Counter[str] = Counter()

    def counted(function):
        def count(folder=".", *rest):
            counts[os.fspath(folder)] += 1
            return function(folder, *rest)

        return count

    monkeypatch.setattr(os, "scandir", counted(os.scandir))
    monkeypatch.setattr(os, "listdir", counted(os.listdir))
    monkeypatch.setattr(listing, "scandir", counted(listing.scandir))
    assert recognise(tmp_path) is None
    assert counts[str(tmp_path)] <= 5
