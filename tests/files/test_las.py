"""LAS by hand, LAZ by laspy as the independent oracle: values, units, flags, times, and headers that lie."""

import io
import math
import struct
from pathlib import Path

import numpy as np
import pytest
from las_files import extra_bytes, geo_keys, las_bytes, point_1, point_7, wkt

from farfield.errors import FileFormatError
from farfield.files.las import las_middle, read_las

POINTS = [point_1(1000, -2000, 1500, 255, time=10.0), point_1(-3000, 4000, -1500, 7, flags=2 | 32, time=10.05)]
UTM = '"WGS 84 / UTM zone 32N"'
METRE, FOOT = 'UNIT["metre",1,AUTHORITY["EPSG","9001"]]', 'UNIT["US survey foot",0.304800609601219]'
GEOGRAPHIC = 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.25]],UNIT["degree",0.0174532925]]'
PROJECTED = f'PROJCS[{UTM},{GEOGRAPHIC},PROJECTION["Transverse_Mercator"],PARAMETER["false_easting",500000],{{}}]'


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cloud.las"


def read(path: Path, data: bytes) -> dict[str, np.ndarray]:
    path.write_bytes(data)
    return dict(read_las(path).columns)


def test_the_middle_is_that_of_the_box_or_the_first_point(path: Path) -> None:
    for data, middle in (
        (las_bytes(POINTS, bounds=(30, 10, 7, 5, 2, -2)), [20, 6, 0]),
        (las_bytes(POINTS, offset=(100, 0, -2)), [101, -2, -0.5]),
        (las_bytes(POINTS, bounds=(10, 30, 7, 5, 2, -2)), [1, -2, 1.5]),
        (las_bytes(POINTS, bounds=(math.nan, 0, 7, 5, 2, -2)), [1, -2, 1.5]),
        (las_bytes([]), None),
        (las_bytes(POINTS, bounds=(math.inf, 0, 7, 5, 2, -2)), None),
        (las_bytes(POINTS)[:200], None),
        (b"ply\n" + bytes(500), None),
    ):
        path.write_bytes(data)
        middle_m = las_middle(path)
        assert (None if middle_m is None else middle_m.tolist()) == middle


@pytest.mark.parametrize("minor", [0, 1, 2, 3, 4])
def test_a_point_of_format_1_by_hand(path: Path, minor: int) -> None:
    columns = read(path, las_bytes(POINTS, minor=minor, scale=(0.01, 0.001, 0.5), offset=(100, 0, -2)))
    assert [columns[axis].tolist() for axis in "xyz"] == [[110.0, 70.0], [-2.0, 4.0], [748.0, -752.0]]
    assert columns["x"].dtype == np.float64
    assert columns["intensity"].tolist() == [255, 7]
    assert {name: columns[name].tolist() for name in ("return_number", "number_of_returns")} == {
        "return_number": [1, 1], "number_of_returns": [1, 1],
    }  # fmt: skip
    assert columns["scan_direction_flag"].tolist() == [1, 1]
    assert columns["edge_of_flight_line"].tolist() == [0, 0]
    assert columns["classification"].tolist() == [0, 2]
    assert columns["synthetic"].tolist() == [0, 1]
    assert columns["scan_angle_deg"].tolist() == [-5, -5]
    assert (columns["user_data"].tolist(), columns["point_source_id"].tolist()) == ([17, 17], [42, 42])
    assert columns["gps_time"].tolist() == [10.0, 10.05]
    assert columns["offset_ns"].tolist() == [0, 50_000_000]


def test_a_point_of_format_7_by_hand(path: Path) -> None:
    point = point_7(1, 2, 3, 9, flags=0b1010_1010, time=0.5)
    columns = read(path, las_bytes([point], minor=4, point_format=7))
    expected = {"return_number": 2, "number_of_returns": 3, "synthetic": 0, "key_point": 1, "overlap": 1,
                "scanner_channel": 2, "scan_direction_flag": 0, "edge_of_flight_line": 1, "classification": 200,
                "red": 1, "green": 2, "blue": 65535}  # fmt: skip
    assert {name: int(columns[name][0]) for name in expected} == expected
    assert columns["scan_angle_deg"][0] == np.float32(-30)
    assert "offset_ns" not in columns  # one point spans no time


def test_withheld_points_are_left_out_and_said(path: Path) -> None:
    points = [POINTS[0], point_1(5, 5, 5, flags=0x80), POINTS[1]]
    path.write_bytes(las_bytes(points))
    cloud = read_las(path)
    assert cloud.columns["x"].tolist() == [1.0, -3.0]
    assert cloud.remarks == (f"{path}: 1 point of 3 marked as withheld (deleted): left out",)
    new = las_bytes([point_7(1, 2, 3), point_7(1, 2, 3, flags=4)], minor=4, point_format=7)
    path.write_bytes(new)
    assert len(read_las(path).columns["x"]) == 1


def test_extra_bytes_have_their_names_scales_and_gaps(path: Path) -> None:
    records = [
        ("LASF_Spec", 4, extra_bytes("range", 3, options=8 | 16, scale=0.5, offset=1.0) + extra_bytes("ring", 1)),
    ]
    points = [POINTS[0] + struct.pack("<HBB", 10, 5, 99), POINTS[1] + struct.pack("<HBB", 20, 6, 98)]
    columns = read(path, las_bytes(points, records=records))
    assert columns["range"].tolist() == [6.0, 11.0]
    assert columns["ring"].tolist() == [5, 6]
    assert columns["extra_bytes"].tolist() == [99, 98]  # which nothing describes
    for name, kind in (("X", 1), ("intensity", 1), ("Withheld", 1), ("", 1), ("odd", 31), ("wide", 10)):
        records = [("LASF_Spec", 4, extra_bytes(name, kind))]
        with pytest.raises(FileFormatError, match="LASF_Spec"):
            read(path, las_bytes([POINTS[0] + b"\1\2"], records=records))


@pytest.mark.parametrize(
    ("record", "refused"),
    [
        (geo_keys(k1024=1, k3072=32632, k3076=9001), ""),
        (geo_keys(k1024=1, k3072=25832), ""),
        (geo_keys(k1024=1, k3072=31982), ""),  # SIRGAS 2000 / UTM 22S
        (geo_keys(k1024=1, k3072=3346), ""),  # Lithuania's
        (geo_keys(k1024=1, k3072=3857), "EPSG:3857"),
        (geo_keys(k1024=1, k3072=2048), "EPSG:2048"),  # to the west and south
        (geo_keys(), ""),
        (geo_keys(k1024=1, k3076=9002), "feet"),
        (geo_keys(k1024=1, k3072=32632, k3076=9003), "US survey feet"),
        (geo_keys(k1024=1, k3076=9001, k4099=9002), "heights in feet"),
        (geo_keys(k1024=1, k3076=9001, k4096=6360), "heights in US survey feet"),
        (geo_keys(k1024=2, k2048=4326), "degrees"),
        (geo_keys(k1024=3), "geocentric"),
        (geo_keys(k1024=1, k3072=2263), "EPSG:2263"),
        (geo_keys(k1024=1, k3072=32767), "not told"),
        (("LASF_Projection", 34735, b"\1\0\1\0\0\0\7\0"), "7 keys"),
        (wkt(PROJECTED.format(METRE)), ""),
        (wkt(PROJECTED.format(FOOT)), "US survey foot"),
        (wkt(PROJECTED.format('AXIS["x",EAST]')), "not told"),
        (wkt(GEOGRAPHIC), "degrees"),
        (wkt(f'COMPD_CS["c",{PROJECTED.format(METRE)},VERT_CS["h",VERT_DATUM["v",2005],{METRE}]]'), ""),
        (wkt(f'COMPD_CS["c",{PROJECTED.format(METRE)},VERT_CS["h",VERT_DATUM["v",2005],{FOOT}]]'), "foot"),
        (wkt('PROJCRS["u",BASEGEOGCRS["g"],CONVERSION["c"],CS[Cartesian,2],AXIS["e",east],LENGTHUNIT["metre",1]]'), ""),
        (wkt('PROJCRS["u",CS[Cartesian,2],AXIS["e",east,LENGTHUNIT["foot",0.3048]]]'), "foot"),
        (wkt('GEODCRS["g",DATUM["d"],CS[ellipsoidal,2]]'), "z is not up"),
        (wkt('SURPRISE["g"]'), "not known"),
        (wkt("PROJCS["), "coordinate system"),
        (wkt("PROJCS[" * 100 + "]" * 100), "coordinate system"),
        (wkt(""), ""),
    ],
)
@pytest.mark.parametrize("place", ["records", "extended"])
def test_what_is_no_metre_is_refused_by_name(
    path: Path, place: str, record: tuple[str, int, bytes], refused: str
) -> None:
    data = las_bytes(POINTS, minor=4, **{place: [record]})
    if refused:
        with pytest.raises(FileFormatError, match=refused):
            read(path, data)
    else:
        assert len(read(path, data)["x"]) == 2


def test_adjusted_standard_time_becomes_time_of_the_day(path: Path) -> None:
    # 2024-03-01 00:00:00 UTC is 1709251200 s since 1970 and 1393286418 - 18 s since GPS' epoch
    seconds = 1_709_251_200 - 315_964_800 + 18 - 1_000_000_000
    points = [point_1(1, 1, 1, time=seconds + 0.25), point_1(2, 2, 2, time=seconds)]
    columns = read(path, las_bytes(points, encoding=1))
    assert columns["timestamp_ns"].tolist() == [1_709_251_200_250_000_000, 1_709_251_200_000_000_000]
    assert "timestamp_ns" not in read(path, las_bytes([points[0], point_1(1, 1, 1, time=0.0)], encoding=1))


def test_times_that_are_no_gps_times_are_said(path: Path) -> None:
    points = [point_1(1, 1, 1, time=4.833e12), point_1(2, 2, 2, time=4.8331e12)]
    for encoding in (0, 1):
        path.write_bytes(las_bytes(points, encoding=encoding))
        cloud = read_las(path)
        assert "left as it is" in cloud.remarks[0]
        assert not {"offset_ns", "timestamp_ns"} & set(cloud.columns)
    with pytest.raises(FileFormatError, match="gps_time"):
        read(path, las_bytes([point_1(1, 1, 1, time=math.nan)]))


@pytest.mark.parametrize("count", [0, 1, 3, 2**31, 2**40])
@pytest.mark.parametrize("minor", [2, 4])
def test_counts_that_lie_are_refused(path: Path, minor: int, count: int) -> None:
    if minor == 4 or count < 2**32:
        with pytest.raises(FileFormatError, match="points"):
            read(path, las_bytes(POINTS, minor=minor, count=count, old_count=0 if count >= 2**32 else None))
    with pytest.raises(FileFormatError, match="found 9"):
        read(path, las_bytes(POINTS, minor=4, old_count=9))


def test_room_behind_the_points_is_for_records_alone(path: Path) -> None:
    assert len(read(path, las_bytes(POINTS, minor=4, extended=[("me", 1, b"x" * 500)]))["x"]) == 2
    assert len(read(path, las_bytes(POINTS, tail=b"\0" * 27))["x"]) == 2
    with pytest.raises(FileFormatError, match="3 of them"):
        read(path, las_bytes(POINTS, tail=b"\0" * 28))
    with pytest.raises(FileFormatError, match="points"):
        read(path, las_bytes(POINTS, minor=4, count=1, extended=[("me", 1, b"x" * 500)])[:-600])


def test_points_outside_of_the_promised_box_are_refused(path: Path) -> None:
    box = (1.0, -3.0, 4.0, -2.0, 1.5, -1.5)
    assert len(read(path, las_bytes(POINTS, bounds=box))["x"]) == 2
    for axis in range(6):
        wrong = [*box]
        wrong[axis] -= 0.01 * (-1) ** axis
        with pytest.raises(FileFormatError, match="header says"):
            read(path, las_bytes(POINTS, bounds=tuple(wrong)))  # type: ignore[arg-type]


def test_counts_by_return_that_differ_are_said(path: Path) -> None:
    for by_return, said in (((2, 0, 0, 0, 0), False), ((0, 0, 0, 0, 0), False), ((1, 1, 0, 0, 0), True)):
        path.write_bytes(las_bytes(POINTS, by_return=by_return))
        assert any("by return" in remark for remark in read_las(path).remarks) == said


@pytest.mark.parametrize(
    ("at", "value"),
    [(0, b"L"), (24, b"\2"), (25, b"\5"), (94, b"\1\0"), (96, b"\xff" * 4), (100, b"\xff" * 4), (104, b"\4"),
     (104, b"\x41"), (105, b"\1\0"), (131, b"\0" * 8), (131, b"\xff" * 8), (155, b"\xff" * 8), (107, b"\xff" * 4)],
)  # fmt: skip
def test_headers_that_cannot_be_are_refused(path: Path, at: int, value: bytes) -> None:
    data = bytearray(las_bytes(POINTS))
    data[at : at + len(value)] = value if at else b"X"
    with pytest.raises(FileFormatError):
        read(path, bytes(data))


def test_every_cut_is_refused(path: Path) -> None:
    data = las_bytes(POINTS, minor=4, records=[geo_keys(k1024=1, k3076=9001)], extended=[("me", 1, b"xyz")])
    for size in range(0, len(data), 3):
        with pytest.raises(FileFormatError):
            read(path, data[:size])


@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 6, 7, 8])
def test_every_point_format_equals_laspy(path: Path, point_format: int) -> None:
    laspy = pytest.importorskip("laspy")
    rng = np.random.default_rng(point_format)
    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    header.scales, header.offsets = [0.001, 0.01, 0.1], [5.0, -7.0, 0.0]
    cloud = laspy.LasData(header)
    for axis in "xyz":
        cloud[axis] = rng.normal(size=50) * 20
    for name in cloud.point_format.dimension_names:
        if name not in ("X", "Y", "Z", "withheld", "gps_time"):
            bits = cloud.point_format.dimension_by_name(name).num_bits
            cloud[name] = rng.integers(0, 1 << min(bits, 7), 50)
    file = io.BytesIO()
    cloud.write(file)
    columns = read(path, file.getvalue())
    np.testing.assert_array_equal(np.column_stack([columns[axis] for axis in "xyz"]), cloud.xyz)
    theirs = {"scan_angle_rank": "scan_angle_deg", "scan_angle": "scan_angle_deg"}
    for name in cloud.point_format.dimension_names:
        if name not in ("X", "Y", "Z", "withheld"):
            step = 0.006 if name == "scan_angle" else 1
            np.testing.assert_allclose(columns[theirs.get(name, name)], np.asarray(cloud[name]) * step, rtol=1e-6)
