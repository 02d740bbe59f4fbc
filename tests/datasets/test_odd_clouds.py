"""Clouds as real drivers and tools write them: each is read as it is meant, or refused with its file named."""

from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.memory import CloudFiles
from farfield.errors import FarfieldError, FileFormatError
from farfield.files.pcd import write_pcd
from farfield.frame.cloud import read_cloud

POINTS, HOUR_NS = 2_000, 3_600_000_000_000
START_NS = 1_700_000_000_123_456_000
RANDOM = np.random.default_rng(4)
PLACES = RANDOM.uniform(1, 50, (POINTS, 3)).astype(np.float32)
UNITS_NS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1}


def sweeps(root: Path, columns: dict[str, np.ndarray], *, start_ns: int = START_NS, period_ms: int = 100) -> object:
    """Four sweeps, named by their times, of the same columns beside x, y and z; absolute times move with the sweep."""
    for number in range(4):
        axes = dict(zip("xyz", PLACES.T, strict=True))
        write_pcd(root / f"{start_ns + number * period_ms * 1_000_000}.pcd", axes | columns)
    return open_dataset(root)


def turn_ns(period_ms: int = 100) -> np.ndarray:
    return np.round(np.linspace(0, period_ms * 1e6 * 0.999, POINTS)).astype(np.int64)


RELATIVE = {  # name, number type, unit, from which part of a turn before the stamp
    "Ouster": ("t", "u4", "ns", 0.0),
    "Livox": ("offset_time", "u4", "ns", 0.0),
    "Velodyne": ("time", "f4", "s", 1.0),
    "Velodyne since the stamp": ("time", "f4", "s", 0.0),
    "half before": ("timestamp", "f8", "s", 0.5),
    "milliseconds": ("Time", "f4", "ms", 0.0),
    "microseconds before": ("time_offset", "i4", "us", 1.0),
    "16 bits of milliseconds": ("t_ms", "u2", "ms", 0.0),
}
ABSOLUTE = {
    "Hesai": ("timestamp", "f8", "s", None),
    "RoboSense": ("timestamp", "f8", "s", None),
    "Livox 2": ("timestamp", "f8", "ns", None),
    "Luminar": ("timestamp", "i8", "us", None),
    "unsigned": ("time_stamp", "u8", "ns", None),
    "of the hour": ("t", "u4", "us", HOUR_NS),
    "of the hour in floats": ("time", "f8", "s", HOUR_NS),
}


@pytest.mark.parametrize("period_ms", [50, 100, 200])
@pytest.mark.parametrize("driver", RELATIVE)
def test_relative_times_of_drivers(tmp_path: Path, driver: str, period_ms: int) -> None:
    name, dtype, unit, before = RELATIVE[driver]
    offsets_ns = turn_ns(period_ms) - round(before * period_ms * 1e6)
    values = (offsets_ns / UNITS_NS[unit]).astype(dtype)
    data = sweeps(tmp_path, {name: values}, period_ms=period_ms)
    step_ns = UNITS_NS[unit] if np.dtype(dtype).kind in "iu" else 100
    np.testing.assert_allclose(data[2].clouds["lidar"].extra["offset_ns"], offsets_ns, atol=step_ns)


@pytest.mark.parametrize("driver", ABSOLUTE)
def test_absolute_times_of_drivers(tmp_path: Path, driver: str) -> None:
    name, dtype, unit, modulus = ABSOLUTE[driver]
    times_ns = START_NS + turn_ns() + 7_000
    values = [(int(time) % (modulus or 1 << 62)) / UNITS_NS[unit] for time in times_ns]
    exact = [int(time) % (modulus or 1 << 62) // int(UNITS_NS[unit]) for time in times_ns]
    data = sweeps(tmp_path, {name: np.array(exact if dtype[0] in "iu" else values, dtype=dtype)})
    step_ns = max(UNITS_NS[unit] if dtype[0] in "iu" else 1, 2 * float(np.spacing(max(values))) * UNITS_NS[unit])
    np.testing.assert_allclose(data[0].clouds["lidar"].extra["offset_ns"], turn_ns() + 7_000, atol=step_ns)


def test_counters_that_begin_anew_within_a_sweep(tmp_path: Path) -> None:
    counter = ((1 << 32) - 40_000_000 + turn_ns()) % (1 << 32)
    write_pcd(tmp_path / "a.pcd", dict(zip("xyz", PLACES.T, strict=True)) | {"t": counter.astype(np.uint32)})
    offsets = read_cloud(tmp_path / "a.pcd").extra["offset_ns"]
    np.testing.assert_array_equal(offsets - offsets[0], turn_ns())

    start_ns = START_NS - START_NS % HOUR_NS - 40_000_000
    micros = (start_ns + turn_ns()) % HOUR_NS // 1000
    hour = tmp_path / "hour"
    hour.mkdir()
    cloud = sweeps(hour, {"t": micros.astype(np.uint32)}, start_ns=start_ns)[0].clouds["lidar"]
    np.testing.assert_allclose(np.diff(cloud.extra["offset_ns"]), np.diff(turn_ns()), atol=1000)


def test_a_unit_of_its_own_in_one_sweep_is_refused(tmp_path: Path) -> None:
    """Three sweeps in microseconds, and the last in nanoseconds: 100 ms would become 100 s, or one be 0.1 ms."""
    data = sweeps(tmp_path, {"t": (turn_ns() // 1000).astype(np.uint32)})
    axes = dict(zip("xyz", PLACES.T, strict=True))
    write_pcd(data.clouds[3], axes | {"t": turn_ns().astype(np.uint32)})
    data = open_dataset(tmp_path)
    assert data[0].clouds["lidar"].extra["offset_ns"].max() == pytest.approx(99_900_000, abs=1000)
    with pytest.raises(FileFormatError, match=data.clouds[3].name):
        _ = data[3].clouds["lidar"]


def test_few_points_have_the_unit_of_the_other_sweeps(tmp_path: Path) -> None:
    data = sweeps(tmp_path, {"t": (turn_ns() // 1000).astype(np.uint32)})
    few = {axis: values[:3] for axis, values in zip("xyz", PLACES.T, strict=True)}
    write_pcd(data.clouds[3], few | {"t": np.array([5, 90, 2000], np.uint32)})
    assert open_dataset(tmp_path)[3].clouds["lidar"].extra["offset_ns"].tolist() == [5_000, 90_000, 2_000_000]


def test_memory_that_nobody_filled_is_no_time(tmp_path: Path) -> None:
    rubbish = RANDOM.integers(0, 1 << 62, POINTS).view(np.float64) * 1e250
    write_pcd(tmp_path / "a.pcd", dict(zip("xyz", PLACES.T, strict=True)) | {"timestamp": rubbish})
    assert list(read_cloud(tmp_path / "a.pcd").extra) == ["timestamp"]


def test_names_of_sixteen_digits_are_no_period_of_a_sweep(tmp_path: Path) -> None:
    """Microseconds since 1970 as names, 100,000 apart, do not make milliseconds of seconds."""
    for number in range(4):
        axes = dict(zip("xyz", PLACES.T, strict=True))
        write_pcd(tmp_path / f"{START_NS // 1000 + number * 100_000}.pcd", axes | {"t": turn_ns() / 1e9})
    frame = open_dataset(tmp_path)[1]
    assert frame.clouds["lidar"].extra["offset_ns"].max() == pytest.approx(99_900_000, abs=1000)
    assert frame.time_ns == START_NS + 100_000_000


SCALES = {
    "0 to 1": (RANDOM.uniform(0, 1, POINTS).astype("f4"), 1),
    "0 to 255 in floats": (RANDOM.uniform(0, 255, POINTS).astype("f4"), 255),
    "0 to 100 in bytes": (RANDOM.integers(0, 100, POINTS).astype("u1"), 255),
    "0 and 1 in bytes": (RANDOM.integers(0, 2, POINTS).astype("u1"), 255),
    "0 to 65535": (RANDOM.integers(0, 65536, POINTS).astype("u2"), 65535),
    "constant": (np.full(POINTS, 0.5, "f4"), 1),
    "zero": (np.zeros(POINTS, "f8"), 1),
}


@pytest.mark.parametrize("scale", SCALES)
def test_scales(tmp_path: Path, scale: str) -> None:
    values, full = SCALES[scale]
    cloud = sweeps(tmp_path, {"Intensity": values})[1].clouds["lidar"]
    np.testing.assert_allclose(cloud.intensity, values / full, rtol=1e-6)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -1.0])
@pytest.mark.parametrize("suffix", [".pcd", ".npy", ".bin", ".xyz"])
def test_one_impossible_intensity_is_refused_not_laundered(tmp_path: Path, wrong: float, suffix: str) -> None:
    values = RANDOM.uniform(0, 1, POINTS).astype(np.float32)
    values[77] = wrong
    path, rows = tmp_path / f"a{suffix}", np.column_stack([PLACES, values])
    if suffix == ".pcd":
        write_pcd(path, dict(zip(("x", "y", "z", "intensity"), rows.T.copy(), strict=True)))
    elif suffix == ".npy":
        np.save(path, rows)
    elif suffix == ".bin":
        rows.tofile(path)
    else:
        np.savetxt(path, rows)
    with pytest.raises(FileFormatError, match=r"intensity|finite"):
        read_cloud(path)
    with pytest.raises(FarfieldError):
        _ = CloudFiles([path])[0].clouds["lidar"]


def test_names_of_columns_are_those_of_the_data_set(tmp_path: Path) -> None:
    """A sweep seen by one ring alone has the same columns as the others."""
    rows = np.column_stack([PLACES, RANDOM.uniform(0, 1, POINTS), np.arange(POINTS) % 32]).astype(np.float32)
    rows.tofile(tmp_path / "a.bin")
    rows.tofile(tmp_path / "b.bin")
    rows[rows[:, 4] == 3].tofile(tmp_path / "c.bin")
    data = open_dataset(tmp_path, bin_columns=5)
    assert [list(frame.clouds["lidar"].extra) for frame in data] == [["ring"]] * 3


def test_orders_in_memory(tmp_path: Path) -> None:
    rows = np.column_stack([PLACES, RANDOM.uniform(0, 1, POINTS)])
    dtype = np.dtype([("X", ">f4"), ("Y", ">f4"), ("Z", ">f4"), ("Reflectivity", ">u2"), ("ring", ">i4")])
    table = np.zeros(POINTS, dtype)
    for name, column in zip("XYZ", PLACES.T, strict=True):
        table[name] = column
    table["Reflectivity"], table["ring"] = 51, np.arange(POINTS) % 64
    saved = {"f": np.asfortranarray(rows), "big": rows.astype(">f8"), "table": table, "grid": table.reshape(40, 50)}
    for name, array in saved.items():
        np.save(tmp_path / f"{name}.npy", array)
        cloud = read_cloud(tmp_path / f"{name}.npy")
        np.testing.assert_array_equal(cloud.points_m, PLACES)
        assert all(column.dtype.isnative for column in (cloud.points_m, cloud.intensity, *cloud.extra.values()))
    assert cloud.intensity[0] == np.float32(0.2)
    assert list(cloud.extra) == ["ring"]


def test_whole_numbers_as_places(tmp_path: Path) -> None:
    """Millimetres in 16 bits are read as they are: the doctor names the unit. -32768 has no positive of its kind."""
    rows = np.array([[-32768, 0, 0], [100, 5, 3], [0, 0, 0], [7, 8, 9]], np.int16)
    np.save(tmp_path / "a.npy", rows)
    cloud = read_cloud(tmp_path / "a.npy")
    assert cloud.missing == 1
    np.testing.assert_array_equal(cloud.points_m, rows[[0, 1, 3]])


def test_fields_of_several_numbers_and_of_one_name(tmp_path: Path) -> None:
    axes = dict(zip("xyz", PLACES.T, strict=True))
    write_pcd(tmp_path / "a.pcd", axes | {"rgb": np.ones((POINTS, 3), np.float32)})
    assert list(read_cloud(tmp_path / "a.pcd").extra) == ["rgb_0", "rgb_1", "rgb_2"]
    write_pcd(tmp_path / "b.pcd", axes | {"intensity": np.ones((POINTS, 2), np.float32)})
    with pytest.raises(FileFormatError, match="COUNT 1"):
        read_cloud(tmp_path / "b.pcd")
    strong = {"Intensity": np.full(POINTS, 200, np.uint8), "intensity": np.full(POINTS, 0.5, np.float32)}
    write_pcd(tmp_path / "c.pcd", axes | strong)
    cloud = read_cloud(tmp_path / "c.pcd")
    assert cloud.intensity[0] == 0.5
    assert cloud.extra["Intensity"][0] == 200
    text = (tmp_path / "c.pcd").read_bytes().replace(b"z Intensity intensity", b"z intensity intensity")
    (tmp_path / "d.pcd").write_bytes(text)
    with pytest.raises(FileFormatError, match="differ from one another"):
        read_cloud(tmp_path / "d.pcd")
    flat = {**axes, "rgb": np.ones((POINTS, 2), np.float32), "rgb_0": np.zeros(POINTS, np.float32)}
    write_pcd(tmp_path / "e.pcd", flat)
    with pytest.raises(FileFormatError, match="rgb_0"):
        read_cloud(tmp_path / "e.pcd")


def test_an_organised_cloud_counts_what_did_not_return(tmp_path: Path) -> None:
    places = PLACES.copy()
    places[::4] = np.nan
    places[1::4] = 0
    columns = dict(zip("xyz", places.T.copy(), strict=True))
    columns |= {"intensity": np.where(np.isnan(places[:, 0]), np.nan, 0.5).astype(np.float32)}
    columns |= {"t": np.where(np.isnan(places[:, 0]), 0, turn_ns()).astype(np.uint32)}
    write_pcd(tmp_path / "a.pcd", columns, height=40)
    cloud = read_cloud(tmp_path / "a.pcd")
    assert (len(cloud), cloud.missing) == (POINTS // 2, POINTS // 2)
    assert cloud.extra["offset_ns"].max() == turn_ns()[-1]


def test_seconds_since_1970_in_float32_are_refused_though_all_are_one(tmp_path: Path) -> None:
    times = ((START_NS + turn_ns()) / 1e9).astype(np.float32)
    write_pcd(tmp_path / "a.pcd", dict(zip("xyz", PLACES.T, strict=True)) | {"time": times})
    with pytest.raises(FileFormatError, match=r"tell points apart.*float32"):
        read_cloud(tmp_path / "a.pcd")
