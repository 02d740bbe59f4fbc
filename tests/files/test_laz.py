"""LAZ: what laspy packs comes out equal; damaged points, tables and records end in a named error, never in a crash."""

import io
import struct
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FarfieldError, FileFormatError, MissingExtraError
from farfield.files import laz
from farfield.files.las import las_middle, parse_las_header, read_las

laspy = pytest.importorskip("laspy")
pytest.importorskip("lazrs")


def packed(point_format: int, points: int = 3000, *, compress: bool = True) -> bytes:
    rng = np.random.default_rng(point_format)
    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    header.scales, header.offsets = [0.001] * 3, [0.0] * 3
    cloud = laspy.LasData(header)
    for axis in "xyz":
        cloud[axis] = rng.normal(size=points) * 20
    cloud.intensity = rng.integers(0, 255, points)
    cloud.return_number, cloud.number_of_returns = rng.integers(1, 4, points), np.full(points, 3)
    cloud.classification = rng.integers(0, 31, points)
    if point_format:
        cloud.gps_time = np.sort(rng.uniform(10, 10.1, points))
    file = io.BytesIO()
    cloud.write(file, do_compress=compress)
    return file.getvalue()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cloud.laz"


@pytest.mark.parametrize("point_format", [0, 1, 6, 7])
def test_packed_points_equal_those_that_are_not(path: Path, point_format: int) -> None:
    path.write_bytes(packed(point_format, compress=False))
    expected = read_las(path).columns
    path.write_bytes(packed(point_format))
    columns = read_las(path).columns
    assert list(columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(columns[name], values)


def test_several_chunks_and_none(path: Path) -> None:
    path.write_bytes(packed(1, 60_000))
    assert len(read_las(path).columns["x"]) == 60_000
    path.write_bytes(packed(1, 0))
    assert len(read_las(path).columns["x"]) == 0


@pytest.mark.parametrize("point_format", [1, 7])
def test_the_first_point_of_a_file_without_a_box_is_not_packed(path: Path, point_format: int) -> None:
    data = packed(point_format)
    path.write_bytes(changed(data, 179, bytes(48)))
    columns, middle_m = read_las(path).columns, las_middle(path)
    assert middle_m is not None
    assert middle_m.tolist() == pytest.approx([columns[axis][0] for axis in "xyz"])


def changed(data: bytes, at: int, value: bytes) -> bytes:
    return data[:at] + value + data[at + len(value) :]


@pytest.mark.parametrize("point_format", [1, 7])
def test_tables_of_chunks_that_lie_are_refused_before_anything_is_unpacked(
    path: Path, point_format: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = packed(point_format)
    start = parse_las_header(data, path=path).start
    table = struct.unpack_from("<q", data, start)[0]
    monkeypatch.setattr(laz.subprocess, "run", None)
    damaged = [changed(data, table + 4, struct.pack("<I", count)) for count in (0, 2, 1000, 2**32 - 1)]
    damaged += [changed(data, start, struct.pack("<q", at)) for at in (-7, 0, start, len(data) - 4, len(data), 2**62)]
    damaged += [changed(data, start, struct.pack("<q", -1)), changed(data, table, b"\1"), data[:start]]
    for bad in damaged:
        path.write_bytes(bad)
        with pytest.raises(FileFormatError):
            read_las(path)


def test_a_table_behind_the_file_is_taken(path: Path) -> None:
    data = packed(1)
    start = parse_las_header(data, path=path).start
    table = struct.unpack_from("<q", data, start)[0]
    path.write_bytes(changed(data, start, struct.pack("<q", -1)) + struct.pack("<q", table))
    assert len(read_las(path).columns["x"]) == 3000


@pytest.mark.parametrize("point_format", [1, 7])
def test_damaged_points_end_in_an_error_and_not_in_a_crash(path: Path, point_format: int) -> None:
    data = packed(point_format, 20_000)
    start = parse_las_header(data, path=path).start
    rng = np.random.default_rng(4)
    damaged = [changed(data, start + 500, b"\xff" * 50_000), changed(data, start + 40, rng.bytes(3000))]
    damaged += [changed(data, start + 8 + at, struct.pack("<I", 2**32 - 16)) for at in (36, 40, 44, 48)]
    for bad in damaged:
        path.write_bytes(bad)
        with pytest.raises(FileFormatError):
            read_las(path)


def test_more_or_fewer_points_than_are_packed_are_refused(path: Path) -> None:
    data = packed(1)
    for count in (2999, 3001, 4000, 50_001, 2**31):
        path.write_bytes(changed(data, 107, struct.pack("<I", count)))
        with pytest.raises(FileFormatError):
            read_las(path)


@pytest.mark.parametrize(
    ("at", "value"), [(0, b"\0\0"), (2, b"\1\0"), (12, b"\0" * 4), (32, b"\0\0"), (32, b"\xff\xff"), (36, b"\xff\0")]
)
def test_records_that_contradict_the_points_are_refused(path: Path, at: int, value: bytes) -> None:
    data = packed(1)
    record = data.index(b"laszip encoded") + 52
    path.write_bytes(changed(data, record + at, value))
    with pytest.raises(FileFormatError, match="laszip encoded"):
        read_las(path)


def test_a_file_without_its_record_is_refused(path: Path) -> None:
    path.write_bytes(packed(1).replace(b"laszip encoded", b"something else"))
    with pytest.raises(FileFormatError, match="laszip encoded"):
        read_las(path)


def test_without_lazrs_the_extra_is_named(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path.write_bytes(packed(1))
    monkeypatch.setattr(laz, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="lazrs"):
        read_las(path)


@pytest.mark.parametrize(
    ("status", "message", "part"),
    [
        (-9, b"", r"ended by SIGKILL \(perhaps for want of memory\)"),
        (-15, b"", "ended by SIGTERM"),
        (-60, b"", "ended by signal 60"),
        (4, b"", "no memory"),
        (1, b"Traceback:\nImportError: DLL load failed", "DLL load failed"),
    ],
)
def test_a_process_that_is_ended_is_no_damaged_file(
    path: Path, monkeypatch: pytest.MonkeyPatch, status: int, message: bytes, part: str
) -> None:
    path.write_bytes(packed(1))
    ended = subprocess.CompletedProcess([], status, b"", message)
    monkeypatch.setattr(laz.subprocess, "run", lambda *words, **options: ended)
    with pytest.raises(FarfieldError, match=part) as caught:
        read_las(path)
    assert not isinstance(caught.value, FileFormatError)
    assert "may be whole" in str(caught.value)


@pytest.mark.parametrize("status", [-11, -6, 1, 3221225477])
def test_a_decoder_that_falls_shows_a_damaged_file(path: Path, monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    path.write_bytes(packed(1))
    ended = subprocess.CompletedProcess([], status, b"", b"thread '<unnamed>' panicked at src/lib.rs")
    monkeypatch.setattr(laz.subprocess, "run", lambda *words, **options: ended)
    with pytest.raises(FileFormatError, match="damaged"):
        read_las(path)


@pytest.mark.parametrize("program", ["", "/nowhere/python"])
def test_a_process_that_does_not_start_is_no_damaged_file(
    path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    path.write_bytes(packed(1))
    monkeypatch.setattr(laz.sys, "executable", program)
    with pytest.raises(FarfieldError, match="does not start"):
        read_las(path)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_too_little_memory_is_said_by_the_worker() -> None:
    import resource

    content = bytes(100 << 20)
    worker = [sys.executable, "-I", "-S", str(Path(laz.__file__).with_name("laz_worker.py")), "/nowhere"]
    done = subprocess.run(
        worker,
        input=laz.HEAD.pack(0, 1, 28, 0, len(content)) + content,
        capture_output=True,
        check=False,
        preexec_fn=partial(resource.setrlimit, resource.RLIMIT_AS, (80 << 20, 80 << 20)),
    )
    assert done.returncode == laz.NO_MEMORY


@pytest.mark.slow
@pytest.mark.parametrize("point_format", [1, 7])
def test_a_thousand_damaged_files_end_in_an_error_or_in_sound_points(path: Path, point_format: int) -> None:
    data = packed(point_format, 2000)
    path.write_bytes(data)
    bounds = [(values.min(), values.max()) for values in map(read_las(path).columns.get, "xyz") if values is not None]
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(500):
        bad = bytearray(data)
        at = int(rng.integers(len(bad)))
        match rng.integers(4):
            case 0:
                bad[at] ^= 1 << int(rng.integers(8))
            case 1:
                bad[at : at + 4] = rng.bytes(4)
            case 2:
                bad[at : at + 8] = b"\xff" * 8
            case _:
                del bad[at:]
        path.write_bytes(bytes(bad))
        try:
            columns = read_las(path).columns
        except FileFormatError:
            refused += 1
            continue
        for name, (low, high) in zip("xyz", bounds, strict=True):
            if bytes(bad[131:227]) == data[131:227]:  # the header's scales and box are whole
                assert low - 0.01 <= columns[name].min() <= columns[name].max() <= high + 0.01
    assert refused > 250


def test_chunks_of_any_size_are_no_more_than_their_first_points_fit(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = packed(1)
    record = data.index(b"laszip encoded") + 52
    table = struct.unpack_from("<q", data, parse_las_header(data, path=path).start)[0]
    variable = changed(data, record + 12, b"\xff" * 4)
    monkeypatch.setattr(laz.subprocess, "run", None)
    for count in (len(data) // 28 + 1, 2**32 - 1):
        path.write_bytes(changed(variable, table + 4, struct.pack("<I", count)))
        with pytest.raises(FileFormatError, match="at most"):
            read_las(path)
