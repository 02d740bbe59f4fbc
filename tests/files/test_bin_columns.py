"""How many columns a .bin file has, told by its numbers: real files, other layouts, files that do not show it."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.clouds import bin_columns


def sweep(points: int, seed: int = 0) -> np.ndarray:
    """x, y, z, reflectance of a scanner's turn over flat ground with walls."""
    random = np.random.default_rng(seed)
    azimuth = np.linspace(-np.pi, np.pi, points)
    ranges = random.uniform(4, 60, points)
    z = np.where(random.random(points) < 0.6, -1.7 + random.normal(0, 0.03, points), random.uniform(-1.7, 3, points))
    columns = (ranges * np.cos(azimuth), ranges * np.sin(azimuth), z, random.beta(2, 6, points))
    return np.column_stack(columns).astype(np.float32)


def written(path: Path, rows: np.ndarray) -> Path:
    np.ascontiguousarray(rows, dtype="<f4").tofile(path)
    return path


@pytest.mark.parametrize("shuffled", [False, True])
@pytest.mark.parametrize("points", [840, 21_000])  # many numbers of columns divide these
@pytest.mark.parametrize("count", [3, 4, 5, 6])
def test_the_number_of_columns_is_that_which_was_written(
    tmp_path: Path, points: int, count: int, *, shuffled: bool
) -> None:
    rows = sweep(points)
    whole = [rows[:, :3], 255 * rows[:, 3:], np.arange(points)[:, None] % 32, np.linspace(0, 0.1, points)[:, None]]
    rows = np.column_stack(whole)[:, :count]
    rows = np.random.default_rng(1).permutation(rows) if shuffled else rows
    found = bin_columns(written(tmp_path / "a.bin", rows))
    assert found.count == count
    assert found.names == ("x", "y", "z", "intensity", "ring", "extra1")[:count]
    assert found.likely


def test_a_column_that_is_the_range_is_named_so(tmp_path: Path) -> None:
    rows = sweep(3_000)
    signal = np.random.default_rng(2).normal(0, 4, (3_000, 1))
    rows = np.column_stack([rows[:, :3], signal, np.linalg.norm(rows[:, :3], axis=1), rows[:, 3] * 40, signal, signal])
    found = bin_columns(written(tmp_path / "a.bin", rows))
    assert (found.count, found.names[3:5]) == (8, ("signal", "range_m"))
    assert str(found).startswith("8 columns a point (x, y, z, signal, range_m")


def test_few_points_are_taken_for_kittis_and_it_says_so(tmp_path: Path) -> None:
    found = bin_columns(written(tmp_path / "a.bin", sweep(10)))
    assert (found.count, found.likely) == (4, False)
    assert "too few" in str(found)


@pytest.mark.parametrize(
    "rows",
    [
        np.random.default_rng(3).normal(size=(5_000, 4)),  # noise has no columns
        sweep(5_000).reshape(-1)[:-4][:, None][:-1],  # cut within a point
        sweep(2_000).astype(np.float64).view(np.float32),  # float64
        np.full((2, 3), np.nan),
        np.zeros((0, 4)),
    ],
    ids=["noise", "cut", "float64", "nan", "empty"],
)
def test_what_stays_in_doubt_is_refused(tmp_path: Path, rows: np.ndarray) -> None:
    with pytest.raises(FileFormatError, match="a\\.bin"):
        bin_columns(written(tmp_path / "a.bin", rows))


def test_real_files_show_their_columns(shared_real: Path) -> None:
    for folder, count in (("kitti/training/velodyne", 4), ("tj4dradset/training/velodyne", 8)):
        for path in sorted((shared_real / folder).glob("*.bin")):
            assert bin_columns(path).count == count, path
    for path in shared_real.glob("view_of_delft/**/velodyne/*.bin"):
        assert bin_columns(path).count == (7 if "radar" in str(path.relative_to(shared_real)) else 4), path
