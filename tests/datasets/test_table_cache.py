"""Large tables of the nuScenes schema come from arrays that an earlier command left, where these hold."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.nuscenes import table_cache
from farfield.errors import FileFormatError
from farfield.files.nuscenes_tables import TokenLists

from .generators.nuscenes_trees import write_nuscenes
from .generators.truth import check_dataset, open_recognised


@pytest.fixture
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where caches of tables of any size come to lie."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(table_cache, "LEAST_BYTES", 1)
    return tmp_path / "cache" / "farfield"


@pytest.fixture
def no_reading(monkeypatch: pytest.MonkeyPatch):
    """Forbids reading JSON tables from now on."""

    def refuse(*_: object) -> None:
        raise AssertionError("read from JSON")

    return lambda: monkeypatch.setattr(table_cache, "read_table", refuse)


@pytest.mark.parametrize("dialect", ["nuscenes", "truckscenes", "t4"])
def test_a_second_opening_reads_no_json_and_gives_the_same(tmp_path, caches, no_reading, dialect):
    truth = write_nuscenes(tmp_path / "set", dialect=dialect)
    first = open_recognised(tmp_path / "set")
    assert list(caches.glob("tables-*.npz"))
    no_reading()
    second = open_recognised(tmp_path / "set")
    check_dataset(second, truth)
    for name, columns in first.stores[0].columns.items():
        for column, values in columns.items():
            other = second.stores[0][name][column]
            if isinstance(values, TokenLists):
                np.testing.assert_array_equal(values.starts, other.starts)
                values, other = values.tokens, other.tokens
            assert values.dtype == other.dtype
            np.testing.assert_array_equal(values, other)


def test_a_table_that_changed_is_read_anew(tmp_path, caches):
    write_nuscenes(tmp_path / "set")
    open_dataset(tmp_path / "set")
    path = tmp_path / "set/v1.0-mini/scene.json"
    rows = json.loads(path.read_text())
    status = path.stat()
    rows[0]["name"] = "scene-9061"
    path.write_text(json.dumps(rows))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns + 1000))
    assert "scene-9061" in open_dataset(tmp_path / "set").sequences
    path.write_text("[{]")
    with pytest.raises(FileFormatError, match=r"scene\.json"):
        open_dataset(tmp_path / "set")


@pytest.mark.parametrize(
    "damage", [lambda data: b"", lambda data: data[:-200], lambda data: data.replace(b"scene-0061", b"scene-9961")]
)
def test_a_damaged_cache_is_written_anew(tmp_path, caches, no_reading, damage):
    write_nuscenes(tmp_path / "set")
    names = open_dataset(tmp_path / "set").sequences
    for path in caches.glob("tables-*.npz"):
        path.write_bytes(damage(path.read_bytes()))
    assert open_dataset(tmp_path / "set").sequences == names
    no_reading()
    assert open_dataset(tmp_path / "set").sequences == names


def test_where_nothing_can_be_written_tables_are_read(tmp_path, caches, monkeypatch):
    write_nuscenes(tmp_path / "set")
    caches.parent.mkdir(parents=True)
    caches.write_text("a file in the folder's place")
    assert len(open_dataset(tmp_path / "set"))


def test_small_tables_leave_nothing_on_the_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_nuscenes(tmp_path / "set")
    open_dataset(tmp_path / "set")
    assert not (tmp_path / "cache").exists()
