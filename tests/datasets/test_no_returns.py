"""Directions without return, as 0, 0, 0 or NaN, are left out and counted; upper-case suffixes; rows of other kinds."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.argoverse2 import _read_sweep
from farfield.datasets.astyx import _read_lidar, _read_radar
from farfield.datasets.bags.reader import cloud_of
from farfield.datasets.cirrus.layout import Xyz
from farfield.datasets.cirrus.reader import CirrusSweep, IntensityScale
from farfield.datasets.kitti.object import read_radar as read_tj4d
from farfield.datasets.kradar.products import read_lidar
from farfield.datasets.radiate import lidar_cloud
from farfield.datasets.view_of_delft.reader import read_radar as read_delft
from farfield.errors import DatasetError, FileFormatError
from farfield.files.astyx import LIDAR_COLUMNS
from farfield.files.clouds import write_cache
from farfield.files.pcd import write_pcd
from farfield.frame.cloud import CloudSettings, read_cloud
from farfield.inspection.doctor import examine

POINTS, GONE = 600, 200
LIDAR = " ".join(LIDAR_COLUMNS)
NAMES = ("x", "y", "z", "intensity")


def rows_of(value: float) -> np.ndarray:
    """x, y, z and intensity; each third row is a direction without return."""
    rows = np.random.default_rng(0).uniform(0.1, 0.9, (POINTS, 4)).astype(np.float32)
    rows[:, :3] *= (60, 50, 3)
    rows[::3, :3] = value
    return rows


def write(path: Path, rows: np.ndarray) -> Path:
    fields = dict(zip(NAMES, rows.T, strict=True))
    if path.suffix.lower() == ".pcd":
        write_pcd(path, fields)
    elif path.suffix.lower() == ".ffcloud":
        write_cache(path, fields)
    elif path.suffix.lower() == ".bin":
        rows.tofile(path)
    elif path.suffix.lower() == ".npy":
        np.save(path.with_suffix(".npy"), rows)
        path.with_suffix(".npy").rename(path)
    else:
        np.savetxt(path, rows, fmt="%.6f")
    return path


@pytest.mark.parametrize("value", [0.0, np.nan])
@pytest.mark.parametrize("suffix", [".pcd", ".bin", ".npy", ".xyz", ".ffcloud"])
@pytest.mark.parametrize("upper", [False, True])
def test_own_files(suffix: str, value: float, upper: bool, tmp_path: Path) -> None:
    write(tmp_path / f"a{suffix.upper() if upper else suffix}", rows_of(value))
    data = open_dataset(tmp_path)
    cloud = data[0].cloud()
    assert (len(cloud), cloud.missing) == (POINTS - GONE, GONE)
    assert cloud.column("intensity").min() > 0.09
    said = " ".join(finding.what for finding in examine(data).findings)
    assert "200 invalid points (no return) left out" in said


def test_kitti_in_upper_case_with_pictures(tmp_path: Path) -> None:
    from farfield.files.images import write_image

    for folder in ("velodyne", "image_2"):
        (tmp_path / "training" / folder).mkdir(parents=True)
    write(tmp_path / "training" / "velodyne" / "000000.BIN", rows_of(0.0))
    write_image(tmp_path / "training" / "image_2" / "a.png", np.zeros((4, 6, 3), np.uint8))
    (tmp_path / "training" / "image_2" / "a.png").rename(tmp_path / "training" / "image_2" / "000000.PNG")
    frame = open_dataset(tmp_path)[0]
    assert frame.cloud().missing == GONE
    assert frame.images["camera"].shape == (4, 6, 3)
    own = tmp_path / "own"
    own.mkdir()
    write(own / "7.PCD", rows_of(0.0))
    shutil.copy(tmp_path / "training" / "image_2" / "000000.PNG", own / "7.PNG")
    assert list(open_dataset(own)[0].images) == ["camera"]


def test_an_infinite_place_is_refused_in_every_file(tmp_path: Path) -> None:
    rows = rows_of(0.0)
    rows[1, 1] = np.inf
    for suffix in (".pcd", ".bin", ".npy", ".xyz", ".ffcloud"):
        with pytest.raises(DatasetError, match="finite coordinates"):
            read_cloud(write(tmp_path / f"a{suffix}", rows))


def test_kitti_like_radars(tmp_path: Path) -> None:
    rows = np.tile(rows_of(0.0), (1, 2))
    rows[:, 4], rows[:, 6] = np.linalg.norm(rows[:, :3], axis=1), -1
    rows.tofile(tmp_path / "tj4d.bin")
    rows[:, :7].tofile(tmp_path / "delft.bin")
    for cloud in (read_tj4d(tmp_path / "tj4d.bin"), read_delft(tmp_path / "delft.bin")):
        assert (len(cloud), cloud.missing) == (POINTS - GONE, GONE)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_cirrus_and_radiate(value: float, tmp_path: Path) -> None:
    rows = np.column_stack([rows_of(value), np.arange(POINTS) % 32])
    np.savetxt(tmp_path / "1.xyz", rows, fmt="%.6f", delimiter=",")
    scale = IntensityScale({"gaussian": ((tmp_path / "1.xyz", tmp_path),)}, Xyz())
    for cloud in (
        CirrusSweep(tmp_path / "1.xyz", tmp_path, "gaussian", Xyz(), scale)(),
        lidar_cloud(tmp_path / "1.xyz"),
    ):
        assert (len(cloud), cloud.missing) == (POINTS - GONE, GONE)


def test_astyx(tmp_path: Path) -> None:
    rows = np.column_stack([rows_of(0.0), np.ones(POINTS)])
    np.savetxt(tmp_path / "radar.txt", rows, fmt="%.6f", header="X Y Z V_r Mag", comments="")
    np.savetxt(tmp_path / "lidar.txt", np.column_stack([rows, np.ones(POINTS)]), fmt="%.6f", header=LIDAR, comments="")
    for cloud in (_read_radar(tmp_path / "radar.txt"), _read_lidar(tmp_path / "lidar.txt", np.eye(4))):
        assert (len(cloud), cloud.missing) == (POINTS - GONE, GONE)


@pytest.mark.parametrize("reader", [read_tj4d, read_delft])
@pytest.mark.parametrize("columns", [4, 5, 6, 7, 8, 9])
def test_rows_of_another_number_of_columns_are_no_radars(reader: Callable, columns: int, tmp_path: Path) -> None:
    """Where the bytes divide by chance: the range, or the number of the scan, is none."""
    if columns == (8 if reader is read_tj4d else 7):
        return
    rows = np.random.default_rng(1).uniform(0.1, 30, (7 * 8 * 9, columns)).astype(np.float32)
    rows.tofile(tmp_path / "a.bin")
    with pytest.raises(FileFormatError, match="columns"):
        reader(tmp_path / "a.bin")


def on_a_map() -> np.ndarray:
    rows = rows_of(0.0).astype(np.float64)
    rows[rows[:, 0] != 0, :2] += (500_000, 5_400_000)  # UTM; what stands at the origin is no return
    return rows


@pytest.mark.parametrize(
    "reader", ["tj4d", "delft", "cirrus", "radiate", "astyx radar", "astyx lidar", "kradar", "bag"]
)
def test_coordinates_of_a_map_are_refused_by_every_reader(reader: str, tmp_path: Path) -> None:
    """They were a ValueError of Cloud itself."""
    rows, path = on_a_map(), tmp_path / "1.xyz"
    seven = np.column_stack([rows, rows[:, 3], rows[:, 3], rows[:, 3]]).astype(np.float32)
    with pytest.raises(DatasetError, match="coordinates of a map"):  # noqa: PT012
        if reader in ("tj4d", "delft"):
            (np.column_stack([seven, seven[:, 3]]) if reader == "tj4d" else seven).tofile(path)
            (read_tj4d if reader == "tj4d" else read_delft)(path)
        elif reader in ("cirrus", "radiate"):
            np.savetxt(path, seven[:, :5], fmt="%.6f", delimiter=",")
            scale = IntensityScale({"gaussian": ((path, tmp_path),)}, Xyz())
            CirrusSweep(path, tmp_path, "gaussian", Xyz(), scale)() if reader == "cirrus" else lidar_cloud(path)
        elif reader == "astyx radar":
            np.savetxt(path, seven[:, :5], fmt="%.6f", header="X Y Z V_r Mag", comments="")
            _read_radar(path)
        elif reader == "astyx lidar":
            np.savetxt(path, seven[:, :6], fmt="%.6f", header=LIDAR, comments="")
            _read_lidar(path, np.eye(4))
        elif reader == "kradar":
            numbers = {"t": "u4", "reflectivity": "u2", "ring": "u1", "ambient": "u2", "range": "u4"}
            whole = {name: np.zeros(POINTS, dtype=dtype) for name, dtype in numbers.items()}
            write_pcd(path, dict(zip(NAMES, rows.T, strict=True)) | whole)
            read_lidar(path, "os2-64")
        else:
            cloud_of(dict(zip(NAMES, rows.T, strict=True)), path, CloudSettings())


def test_argoverse2(tmp_path: Path) -> None:
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    columns = dict(zip(NAMES, rows_of(0.0).T, strict=True))
    columns |= {"laser_number": np.zeros(POINTS, np.uint8), "offset_ns": np.zeros(POINTS, np.int32)}
    feather.write_feather(pyarrow.table(columns), tmp_path / "1.feather")
    cloud = _read_sweep(tmp_path / "1.feather")
    assert (len(cloud), cloud.missing) == (POINTS - GONE, GONE)
    columns |= dict(zip("xyz", on_a_map().T, strict=False))
    feather.write_feather(pyarrow.table(columns), tmp_path / "1.feather")
    with pytest.raises(DatasetError, match="coordinates of a map"):
        _read_sweep(tmp_path / "1.feather")


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_kradars_sweeps_count_what_they_leave_out(value: float, tmp_path: Path) -> None:
    path, columns = tmp_path / "os2-64_00001.pcd", dict(zip(NAMES, rows_of(value).T.copy(), strict=True))
    numbers = {"t": "u4", "reflectivity": "u2", "ring": "u1", "ambient": "u2", "range": "u4"}
    whole = {name: np.zeros(POINTS, dtype=dtype) for name, dtype in numbers.items()}
    write_pcd(path, columns | whole)
    cloud = read_lidar(path, "os2-64")
    assert (len(cloud), cloud.missing) == (POINTS - GONE, GONE)
    columns["intensity"][-1] = np.nan  # of a point: never a dark one
    write_pcd(path, columns | whole)
    with pytest.raises(FileFormatError, match="intensities"):
        read_lidar(path, "os2-64")


class TestStructuredArrays:
    DTYPE = np.dtype(
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("Reflectivity", "u1"), ("t_us", "<u4"), ("n", "f4", 3)]
    )

    def test_are_read_by_name(self, tmp_path: Path) -> None:
        table = np.zeros((4, 100), self.DTYPE)
        table["x"], table["Reflectivity"] = 5, 51
        table["t_us"] = np.linspace(0, 100_000, 400).reshape(4, 100)
        table["x"][0, 0] = 0
        np.save(tmp_path / "a.npy", table)
        cloud = open_dataset(tmp_path)[0].cloud()
        assert (len(cloud), cloud.missing) == (399, 1)
        assert cloud.column("intensity")[0] == pytest.approx(0.2)
        assert cloud.extra["offset_ns"].max() == 100_000_000
        assert [name for name in cloud.extra if name != "offset_ns"] == ["n_0", "n_1", "n_2"]

    def test_of_words_are_refused(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", np.zeros(3, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("name", "U4")]))
        with pytest.raises(FileFormatError, match="fields of numbers, found 'name' of <U4"):
            read_cloud(tmp_path / "a.npy")


class TestSixColumns:
    @pytest.mark.parametrize("suffix", [".xyz", ".npy", ".bin"])
    @pytest.mark.parametrize("kind", ["rgb", "normals", "ring"])
    def test_are_named_by_what_they_hold(self, suffix: str, kind: str, tmp_path: Path) -> None:
        random = np.random.default_rng(1)
        place = rows_of(0.5)[:, :3]
        if kind == "rgb":
            three = random.integers(0, 256, (POINTS, 3)).astype(np.float32)
        elif kind == "normals":
            three = random.normal(size=(POINTS, 3)).astype(np.float32)
            three /= np.linalg.norm(three, axis=1, keepdims=True)
        else:
            three = np.column_stack([random.uniform(0, 1, POINTS), np.arange(POINTS) % 32, np.full(POINTS, 7.5)])
        rows = np.column_stack([place, three]).astype(np.float32)
        path = tmp_path / f"a{suffix}"
        if suffix == ".xyz":
            np.savetxt(path, rows, fmt="%.7g")
        elif suffix == ".npy":
            np.save(path, rows)
        else:
            rows.tofile(path)
        cloud = read_cloud(path, bin_columns=6)
        expected = {"rgb": ("r", "g", "b"), "normals": ("nx", "ny", "nz"), "ring": ("ring", "extra1")}[kind]
        assert tuple(cloud.extra) == expected
        assert (cloud.column("intensity").max() > 0) == (kind == "ring")
