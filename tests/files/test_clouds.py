"""KITTI's binary clouds and the cache format."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files import clouds
from farfield.files.clouds import read_bin, read_cache, write_bin, write_cache

ALL_DTYPES = ["?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8"]


def test_bin_is_rows_of_little_endian_float32(tmp_path: Path) -> None:
    path = tmp_path / "000000.bin"
    path.write_bytes(struct.pack("<8f", 1, 2, 3, 0.5, -1, -2, -3, 0.25))
    rows = read_bin(path)
    assert rows.dtype == np.float32
    assert rows.tolist() == [[1, 2, 3, 0.5], [-1, -2, -3, 0.25]]
    assert read_bin(path, columns=2).shape == (4, 2)
    write_bin(tmp_path / "again.bin", rows)
    assert (tmp_path / "again.bin").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "byte 0: expected at least one point and 16 bytes"),
        (b"\0" * 15, "byte 0: .*found 15 bytes: 0 points and 15 bytes more"),
        (b"\0" * 40, "byte 32: .*2 points and 8 bytes more. The file is truncated"),
        (struct.pack("<8f", 0, 0, 0, 0, 0, np.nan, 0, 0), r"byte 16 \(point 1\): expected finite"),
    ],
)
def test_bin_faults(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        read_bin(tmp_path / "a.bin")


def test_bin_drops_broken_points_on_request(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(struct.pack("<8f", 0, 0, 0, np.inf, 1, 2, 3, 4))
    assert read_bin(tmp_path / "a.bin", on_nan="drop").tolist() == [[1, 2, 3, 4]]


def test_real_kitti_and_view_of_delft_sweeps(shared_real: Path) -> None:
    for path in (shared_real / "kitti").rglob("*.bin"):
        rows = read_bin(path)
        assert len(rows) > 10_000
        assert rows[:, 3].min() >= 0
        assert rows[:, 3].max() <= 1
        assert 40 < np.hypot(rows[:, 0], rows[:, 1]).max() < 130


@pytest.mark.usefixtures("without_shape_checks")
@pytest.mark.parametrize("rows", [np.zeros((0, 4)), np.zeros(4), np.full((1, 4), np.nan)], ids=str)
def test_bin_writes_only_what_can_be_read(tmp_path: Path, rows: np.ndarray) -> None:
    with pytest.raises(ValueError, match="table of finite numbers"):
        write_bin(tmp_path / "a.bin", rows)


def test_cache_round_trip_of_every_dtype_and_shape(tmp_path: Path, rng: np.random.Generator) -> None:
    columns = {name: (rng.random((7, 2)) * 100).astype(name) for name in ALL_DTYPES}
    columns |= {"big endian": np.arange(4, dtype=">i4"), "empty": np.zeros((0, 3)), "scalar": np.float64(3.5)}
    columns |= {
        "strided": np.arange(20)[::3],
        "fortran": np.asfortranarray(rng.random((3, 4))),
        "nan": np.array([np.nan]),
    }
    write_cache(tmp_path / "a.ffcloud", columns)
    found = read_cache(tmp_path / "a.ffcloud")
    assert list(found) == list(columns)
    for name, array in columns.items():
        assert found[name].dtype == array.dtype.newbyteorder("<")
        np.testing.assert_array_equal(found[name], array)
        assert found[name].flags.writeable


def test_an_empty_cache_is_valid(tmp_path: Path) -> None:
    write_cache(tmp_path / "a.ffcloud", {})
    assert read_cache(tmp_path / "a.ffcloud") == {}


@pytest.mark.parametrize(
    "array", [np.array(["text"]), np.array([object()]), np.array([1j])], ids=["str", "object", "complex"]
)
def test_cache_takes_numbers_only(tmp_path: Path, array: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected numbers in column 'a'"):
        write_cache(tmp_path / "a.ffcloud", {"a": array})
    assert not (tmp_path / "a.ffcloud").exists()


def test_a_cache_that_could_not_be_read_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clouds, "MAX_BYTES", 2 << 20)
    write_cache(tmp_path / "a.ffcloud", {"x": np.zeros(1 << 17)})
    with pytest.raises(FileFormatError, match=r"at most 2097152 bytes.*it was not written"):
        write_cache(tmp_path / "b.ffcloud", {"x": np.zeros(1 << 18)})
    assert [path.name for path in tmp_path.iterdir()] == ["a.ffcloud"]


def cache_bytes(columns: object, payload: bytes, **more: object) -> bytes:
    header = json.dumps({"columns": columns, "crc32": zlib.crc32(payload), **more}).encode()
    return b"FFCLOUD1" + struct.pack("<I", len(header)) + header + payload


GOOD = {"name": "x", "dtype": "<f4", "shape": [2]}


def test_the_format_is_as_documented(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(cache_bytes([GOOD], struct.pack("<2f", 1, 2)))
    assert read_cache(tmp_path / "a")["x"].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "byte 0: expected the magic"),
        (b"FFCLOUD1", "byte 0: expected the magic"),
        (b"FFCLOUD2" + bytes(8), "byte 0: expected the magic"),
        (b"FFCLOUD1\xff\xff\xff\xff{}", "byte 8: expected the length of a header"),
        (b"FFCLOUD1\x02\0\0\0{}", "byte 12: expected a JSON header"),
        (b"FFCLOUD1\x02\0\0\0\xff\xff", "byte 12: expected a JSON header"),
        (b"FFCLOUD1" + struct.pack("<I", 200_000) + b"[" * 200_000, "byte 12: expected a JSON header"),
        (cache_bytes(5, b""), "byte 12"),
        (cache_bytes([5], b""), "byte 12"),
        (cache_bytes([GOOD, GOOD], bytes(16)), "unique names"),
        (cache_bytes([GOOD | {"dtype": "O"}], bytes(16)), "known dtypes"),
        (cache_bytes([GOOD | {"dtype": "<f16"}], bytes(32)), "known dtypes"),
        (cache_bytes([GOOD | {"dtype": ["<f4"]}], bytes(8)), "byte 12"),
        (cache_bytes([GOOD | {"shape": [-2, -1]}], bytes(8)), "known dtypes and shapes"),
        (cache_bytes([GOOD | {"shape": [0, 1 << 33, 1 << 33]}], b""), "known dtypes and shapes"),
        (cache_bytes([GOOD | {"shape": [True, 2]}], bytes(8)), "known dtypes and shapes"),
        (
            cache_bytes([GOOD | {"shape": [1 << 39, 1 << 39, 1 << 39]}], bytes(8)),
            "known dtypes and shapes",
        ),
        (cache_bytes([GOOD | {"shape": [1 << 400]}], bytes(8)), "beyond 64 bits"),
        (cache_bytes([GOOD], bytes(7)), "expected 8 bytes of columns, found 7"),
        (cache_bytes([GOOD], bytes(9)), "expected 8 bytes of columns, found 9"),
        (cache_bytes([GOOD], bytes(8), crc32=1), "expected CRC-32 1"),
        (cache_bytes([GOOD], bytes(8), crc32="1"), "byte 12"),
        (cache_bytes([GOOD | {"dtype": "|b1"}], b"\x01\x07"), "booleans"),
    ],
)
def test_cache_faults(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.ffcloud").write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        read_cache(tmp_path / "a.ffcloud")


def test_every_flipped_bit_of_a_cache_is_noticed_or_harmless(tmp_path: Path) -> None:
    write_cache(tmp_path / "a", {"x": np.arange(3.0), "mask": np.array([True, False])})
    whole, expected = (tmp_path / "a").read_bytes(), read_cache(tmp_path / "a")
    noticed = 0
    for position in range(0, 8 * len(whole), 3):
        data = bytearray(whole)
        data[position // 8] ^= 1 << position % 8
        (tmp_path / "b").write_bytes(data)
        try:
            found = read_cache(tmp_path / "b")
        except FileFormatError:
            noticed += 1
            continue
        assert [array.tobytes() for array in found.values()] == [array.tobytes() for array in expected.values()]
    assert noticed > len(whole)
