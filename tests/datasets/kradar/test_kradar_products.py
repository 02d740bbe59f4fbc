"""K-Radar's files, decoded step by step as its development kit does, with NumPy and SciPy only."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from drive import cloud
from PIL import Image

from farfield.datasets.kradar.layout import product_path
from farfield.datasets.kradar.products import (
    CUBE_SHAPE,
    POLAR_SHAPE,
    TESSERACT_SHAPE,
    read_eye,
    read_lidar,
    read_radar,
    write_lidar,
    write_radar,
    write_stereo,
)
from farfield.errors import DatasetError, FileFormatError
from farfield.files.mat import write_mat
from farfield.files.npy import write_npy
from farfield.files.pcd import write_pcd
from farfield.frame import Cloud

RANGE_M = np.arange(256) * 0.462890625
RANGE_BIN, ELEVATION_BIN, AZIMUTH_BIN = 100, 18 + 6, 53 + 20  # 46.3 m, 6 degrees up, 20 degrees left


def test_a_strong_cell_of_the_tesseract_is_where_the_development_kit_looks(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    power = rng.random(TESSERACT_SHAPE, dtype=np.float32)
    power *= np.float32(1e12)
    power[5, RANGE_BIN, ELEVATION_BIN, AZIMUTH_BIN] = 1e13
    write_radar(tmp_path / "t.mat", "tesseract", power)
    stored = scipy.io.loadmat(tmp_path / "t.mat")["arrDREA"]
    assert stored.shape == TESSERACT_SHAPE
    drae = np.transpose(stored, (0, 1, 3, 2))
    doppler, r, a, e = np.unravel_index(int(drae.argmax()), drae.shape)
    azimuth, elevation = -np.deg2rad(np.arange(-53, 54))[a], -np.deg2rad(np.arange(-18, 19))[e]
    x = RANGE_M[r] * np.cos(elevation) * np.cos(azimuth)
    y = RANGE_M[r] * np.cos(elevation) * np.sin(azimuth)
    z = RANGE_M[r] * np.sin(elevation)
    assert doppler == 5
    assert drae[doppler, r, a, e] / 1e13 == np.float32(1e13) / 1e13
    up, left = np.deg2rad(6), np.deg2rad(20)
    expected = RANGE_M[RANGE_BIN] * np.array([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)])
    np.testing.assert_allclose([x, y, z], expected, rtol=1e-12)
    assert min(x, y, z) > 0
    assert np.array_equal(read_radar(tmp_path / "t.mat", "tesseract"), power)  # bit for bit


def test_a_strong_cell_of_the_cube_is_where_the_development_kit_looks(tmp_path: Path) -> None:
    power = np.full(CUBE_SHAPE, -1.0, dtype=np.float32)
    power[90, 250, 100] = 0.5  # above, to the left, ahead
    write_radar(tmp_path / "c.mat", "cube", power)
    stored = scipy.io.loadmat(tmp_path / "c.mat")["arr_zyx"]
    assert stored.min() == -1
    flipped = np.flip(stored, axis=0)
    z, y, x = np.unravel_index(int(flipped.argmax()), flipped.shape)
    axes = np.arange(-30, 30, 0.4), np.arange(-80, 80, 0.4), np.arange(0, 100, 0.4)
    assert [round(float(axis[i]), 1) for axis, i in zip(axes, (z, y, x), strict=True)] == [6.0, 20.0, 40.0]


def test_a_strong_cell_of_the_polar_tensor_is_where_the_development_kit_looks(tmp_path: Path) -> None:
    values = np.zeros(POLAR_SHAPE)
    values[:, RANGE_BIN, AZIMUTH_BIN, ELEVATION_BIN] = 2.0, -1.5
    write_radar(tmp_path / "p.npy", "polar3d", values)
    stored = np.load(tmp_path / "p.npy", allow_pickle=False)
    assert stored.dtype == np.float64
    assert stored.shape == POLAR_SHAPE
    r, a, e = np.unravel_index(int(stored[0].argmax()), POLAR_SHAPE[1:])
    assert (r, -np.arange(-53, 54)[a], -np.arange(-18, 19)[e]) == (RANGE_BIN, 20, 6)
    assert stored[1, r, a, e] == -1.5


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_every_bit_of_a_cube_survives(tmp_path: Path, rng: np.random.Generator, dtype: str) -> None:
    values = rng.random(CUBE_SHAPE, dtype=np.float32) * np.float32(1e13)
    values[0, :, ::3] = -1
    write_radar(tmp_path / "a.mat", "cube", values, dtype=dtype)
    back = read_radar(tmp_path / "a.mat", "cube")
    assert back.dtype == np.dtype(dtype)
    assert np.array_equal(back, values)


def test_every_bit_of_numpy_products_survives(tmp_path: Path, rng: np.random.Generator) -> None:
    polar, sparse = rng.random(POLAR_SHAPE, dtype=np.float32), rng.random((70, 4))
    for product, values in (("polar3d", polar), ("sparse", sparse), ("sparse", sparse[:0])):
        write_radar(tmp_path / "a.npy", product, values)
        back = read_radar(tmp_path / "a.npy", product)
        assert back.dtype == np.float64
        assert np.array_equal(back, values)
    assert np.array_equal(np.load(tmp_path / "a.npy", allow_pickle=False), sparse[:0])


@pytest.mark.parametrize(("lidar", "lines"), [("os2-64", 64), ("os1-128", 128)])
def test_a_sweep_is_a_grid_of_pcls_ascii(tmp_path: Path, rng: np.random.Generator, lidar: str, lines: int) -> None:
    sweep, path = cloud(rng, lines, 2048, 5000), tmp_path / "a.pcd"
    write_lidar(path, sweep, lines=lines, columns=2048)
    rows = np.loadtxt(path, skiprows=11)
    assert rows.shape == (2048 * lines, 9)
    head = path.read_text("ascii").splitlines()[:11]
    assert head[2:8] == [
        "FIELDS x y z intensity t reflectivity ring ambient range",
        "SIZE 4 4 4 4 4 2 1 2 4",
        "TYPE F F F F U U U U U",
        "COUNT 1 1 1 1 1 1 1 1 1",
        "WIDTH 2048",
        f"HEIGHT {lines}",
    ]
    there = rows[(np.abs(rows[:, 0]) > 0.01) | (np.abs(rows[:, 1]) > 0.01)]
    assert np.array_equal(there[:, :3].astype(np.float32), sweep.points_m)
    assert np.count_nonzero(rows.any(axis=1)) == len(sweep)
    place = np.flatnonzero(rows.any(axis=1))
    assert np.array_equal(place // 2048, sweep.extra["ring"])
    back = read_lidar(path, lidar)
    assert np.array_equal(back.points_m, sweep.points_m)
    assert np.array_equal(back.intensity, sweep.intensity)
    assert all(np.array_equal(back.extra[name], values) for name, values in sweep.extra.items())
    assert np.array_equal(back.extra["signal"], sweep.intensity * 1024)


def test_signal_counts_are_kept_and_saturate(tmp_path: Path) -> None:
    points = np.array([[1.0, 2.0, 2.0], [4.0, 0.0, 3.0]], dtype=np.float32)
    extra = {"signal": np.array([512, 5000], dtype=np.uint16)}
    write_lidar(tmp_path / "a.pcd", Cloud(points, np.zeros(2, dtype=np.float32), extra), lines=64, columns=2048)
    back = read_lidar(tmp_path / "a.pcd", "os2-64")
    assert back.extra["signal"].tolist() == [512, 5000]
    assert back.intensity.tolist() == [0.5, 1]
    assert back.extra["range_mm"].tolist() == [3000, 5000]
    assert "column" not in back.extra


@pytest.mark.parametrize(("ring", "column"), [([0, 64], [1, 1]), ([0, 1], [1, 2048]), ([3, 3], [9, 9])])
def test_points_must_have_places_of_their_own(tmp_path: Path, ring: list[int], column: list[int]) -> None:
    extra = {"ring": np.array(ring, dtype=np.uint8), "column": np.array(column, dtype=np.uint16)}
    sweep = Cloud(np.ones((2, 3), dtype=np.float32), np.ones(2, dtype=np.float32), extra)
    with pytest.raises(DatasetError, match=r"a grid of 64 rings|in the same place"):
        write_lidar(tmp_path / "a.pcd", sweep, lines=64, columns=2048)


def test_both_eyes_stand_side_by_side(tmp_path: Path, rng: np.random.Generator) -> None:
    left, right = (rng.integers(0, 256, (720, 1280, 3), dtype=np.uint8) for _ in range(2))
    write_stereo(tmp_path / "a.png", left, right)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (2560, 720)
        both = np.asarray(image)
    assert np.array_equal(both[:, :1280], left)
    assert np.array_equal(both[:, 1280:], right)
    assert np.array_equal(read_eye(tmp_path / "a.png", right=False), left)
    assert np.array_equal(read_eye(tmp_path / "a.png", right=True), right)
    write_stereo(tmp_path / "b.png", None, right)
    assert not read_eye(tmp_path / "b.png", right=False).any()
    with pytest.raises(DatasetError, match="of one size"):
        write_stereo(tmp_path / "c.png", left, right[:5])


def test_other_shapes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"cube: expected an array of shape \(150, 400, 250\), got \(2, 2, 2\)"):
        write_radar(tmp_path / "a.mat", "cube", np.zeros((2, 2, 2)))
    write_mat(tmp_path / "a.mat", "arr_zyx", np.zeros((2, 2, 2)))
    write_npy(tmp_path / "a.npy", np.zeros(()))
    write_pcd(tmp_path / "a.pcd", {name: np.zeros(3, dtype=np.float32) for name in "xyz"})
    with pytest.raises(FileFormatError, match=r"of shape \(150, 400, 250\), found float64 of shape \(2, 2, 2\)"):
        read_radar(tmp_path / "a.mat", "cube")
    with pytest.raises(FileFormatError, match=r"shape \(0, 4\)"):
        read_radar(tmp_path / "a.npy", "sparse")
    with pytest.raises(FileFormatError, match="no single 'intensity' a point"):
        read_lidar(tmp_path / "a.pcd", "os2-64")


def test_files_are_named_as_in_the_real_tree() -> None:
    names = {
        "tesseract": "1/radar_tesseract/tesseract_00033.mat",
        "cube": "1/radar_zyx_cube/cube_00033.mat",
        "polar3d": "rdr_polar_3d/1/polar3d_00033.npy",
        "sparse": "rtnh_wider_10p_1/1/sprdr_00033.npy",
        "os2-64": "1/os2-64/os2-64_00033.pcd",
        "os1-128": "1/os1-128/os1-128_00033.pcd",
        "cam-front": "1/cam-front/cam-front_00033.png",
    }
    assert {product: product_path(product, "1", 33).as_posix() for product in names} == names
