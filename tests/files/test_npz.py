"""NumPy's archives as clouds: which array is the cloud, and what is none."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.npz import read_npz
from farfield.frame.cloud import Cloud

ROWS = np.array([[1, 2, 3, 0.5], [4, 5, 6, 1.0]], dtype=np.float32)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cloud.npz"


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_rows_and_columns_are_one_cloud(path: Path, save: object) -> None:
    x, y, z, strength = ROWS.T
    table = np.zeros(2, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4")])
    for name, values in zip(table.dtype.names or (), ROWS.T, strict=True):
        table[name] = values
    for arrays in (
        {"points": ROWS},
        {"x": x, "y": y, "z": z, "intensity": strength},
        {"xyz": ROWS[:, :3], "intensity": strength},
        {"cloud": table},
    ):
        save(path, **arrays)  # type: ignore[operator]
        cloud = Cloud.from_file(path)
        np.testing.assert_array_equal(cloud.points_m, ROWS[:, :3])
        np.testing.assert_array_equal(cloud.intensity, strength)


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"a": ROWS, "b": ROWS},
        {"points": ROWS, "extra": ROWS[:1, 0]},
        {"x": ROWS[:, 0], "y": ROWS[:, 1]},
        {"x": ROWS[:, 0], "y": ROWS[:, 1], "z": ROWS[:1, 2]},
        {"xyz": ROWS[:, :3], "x": ROWS[:, 0]},
        {"x": ROWS[:, 0], "X": ROWS[:, 0], "y": ROWS[:, 1], "z": ROWS[:, 2]},
        {"cube": np.zeros((2, 3, 4))},
        {"flat": np.zeros(9)},
        {"wide": np.zeros((2, 300))},
        {f"c{number}": ROWS[:, 0] for number in range(260)},
    ],
)
def test_what_could_be_several_clouds_or_none_is_refused(path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(path, **arrays)
    with pytest.raises(FileFormatError):
        read_npz(path)


def test_no_pickle_is_executed(path: Path) -> None:
    np.savez(path, points=np.array([object()], dtype=object))
    with pytest.raises(FileFormatError, match="dtype"):
        read_npz(path)


def test_bombs_and_lies_are_refused(path: Path) -> None:
    npy = io.BytesIO()
    np.lib.format.write_array(npy, np.zeros((30 << 20, 3), dtype=np.uint8))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", npy.getvalue())
    with pytest.raises(FileFormatError, match="at most"):
        read_npz(path)
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f4", "fortran_order": False, "shape": (1 << 50, 3)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("points.npy", head.getvalue() + ROWS.tobytes())
    with pytest.raises(FileFormatError, match="shape"):
        read_npz(path)


def test_damage_is_refused_or_shows(path: Path) -> None:
    np.savez_compressed(path, points=ROWS)
    data = path.read_bytes()
    for size in range(0, len(data), 7):
        path.write_bytes(data[:size])
        with pytest.raises(FileFormatError):
            read_npz(path)
    for place in range(len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x41]) + data[place + 1 :])
        try:
            rows = read_npz(path)
        except FileFormatError:
            continue
        np.testing.assert_array_equal(rows, ROWS)
