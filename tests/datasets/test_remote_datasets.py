"""Every format from a store: the same frames as from a folder, and no byte more than is opened."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from format_fixtures import FIXTURES, fixture_of

from farfield.datasets import open_dataset
from farfield.datasets.formats import DATASETS
from farfield.datasets.open_sweeps import ROOT
from farfield.errors import DatasetError
from farfield.files.remote_paths import list_anew

fsspec = pytest.importorskip("fsspec")


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    system = fsspec.filesystem("memory")
    system.store.clear()
    system.pseudo_dirs.clear()
    list_anew()
    yield system
    system.store.clear()


def _stored(system: Any, root: Path) -> None:
    for path in root.rglob("*"):
        if path.is_file():
            system.pipe_file(f"/bucket/{root.name}/{path.relative_to(root).as_posix()}", path.read_bytes())


def _equal(one: Any, other: Any, where: str) -> None:
    """Compare all that frames hold."""
    assert type(one) is type(other), where
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
    elif dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            _equal(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif hasattr(one, "items"):
        assert list(one) == list(other), where
        for name in one:
            _equal(one[name], other[name], f"{where}[{name}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for index, (left, right) in enumerate(zip(one, other, strict=True)):
            _equal(left, right, f"{where}[{index}]")
    elif isinstance(one, str | int | float | bool | None):
        assert one == other or one != one, where
    elif hasattr(one, "__dict__"):
        for name, value in vars(one).items():
            if not isinstance(value, Path) and not callable(value):
                _equal(value, vars(other)[name], f"{where}.{name}")


@pytest.mark.parametrize("name", [*(name for name in DATASETS.builtin if name in FIXTURES), "open-sweeps"])
def test_frames_of_a_store_are_those_of_the_folder(name: str, memory: Any, tmp_path: Path) -> None:
    root = tmp_path / "data"
    root.mkdir()
    if name == "open-sweeps":
        written = ROOT
    else:
        write = fixture_of(name)
        if write is None:
            pytest.skip(f"nothing writes {name} here")
        try:
            written = write(root)
        except ImportError as error:
            pytest.skip(str(error))
    root = written if isinstance(written, Path) else root
    _stored(memory, root)
    local, remote = open_dataset(root), open_dataset(f"memory://bucket/{root.name}")
    assert remote.name == local.name
    assert (remote.frame_ids, remote.sequences) == (local.frame_ids, local.sequences)
    assert [sentence.replace(str(remote.root), "") for _, sentence in remote.remarks] == [
        sentence.replace(str(local.root), "") for _, sentence in local.remarks
    ]
    for index in {0, len(local) // 2, len(local) - 1}:
        theirs, ours = remote[index], local[index]
        assert list(theirs.clouds) == list(ours.clouds)
        for cloud in ours.clouds:
            _equal(theirs.clouds[cloud], ours.clouds[cloud], cloud)
        for camera in ours.images:
            _equal(theirs.images[camera], ours.images[camera], camera)
        for part in ("boxes", "full_boxes", "sensors", "pose", "conditions", "time_ns"):
            _equal(getattr(theirs, part, None), getattr(ours, part, None), part)
    assert local.identity() == remote.identity() if hasattr(local, "identity") else True


def test_a_folder_that_is_being_uploaded_is_no_data_set(memory: Any, tmp_path: Path) -> None:
    fixture_of("kitti")(tmp_path / "data")  # type: ignore[misc]
    _stored(memory, tmp_path / "data")
    memory.pipe_file("/bucket/data/.farfield-upload", b"unfinished")
    with pytest.raises(DatasetError, match="memory://bucket/data: expected a finished upload"):
        open_dataset("memory://bucket/data")
    memory.rm_file("/bucket/data/.farfield-upload")
    assert len(open_dataset("memory://bucket/data")) == 1  # it is listed anew


def test_what_a_store_lacks_is_said_with_its_url(memory: Any) -> None:
    with pytest.raises(DatasetError, match="memory://bucket/none: expected a data set's folder, found nothing"):
        open_dataset("memory://bucket/none")
