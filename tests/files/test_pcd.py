"""PCD in all three encodings, and the LZF codec within."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.errors import FileFormatError
from farfield.files.pcd import LZF_MAX_EXPANSION, compress_lzf, decompress_lzf, read_pcd, write_pcd

HEADER = {
    "VERSION": "0.7",
    "FIELDS": "x y ring",
    "SIZE": "4 8 2",
    "TYPE": "F F U",
    "COUNT": "1 1 1",
    "WIDTH": "2",
    "HEIGHT": "1",
    "VIEWPOINT": "0 0 0 1 0 0 0",
    "POINTS": "2",
    "DATA": "binary",
}
BODY = struct.pack("<fdHfdH", 1.5, 2.25, 7, -3.0, 1e300, 65535)


def pcd(tmp_path: Path, body: bytes, **changes: str | None) -> Path:
    entries = {key: value for key, value in {**HEADER, **changes}.items() if value is not None}
    path = tmp_path / "cloud.pcd"
    path.write_bytes("".join(f"{key} {value}\n" for key, value in entries.items()).encode() + body)
    return path


def assert_equal(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert list(found) == list(expected)
    for name, array in expected.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


EXPECTED = {
    "x": np.array([1.5, -3], dtype=np.float32),
    "y": np.array([2.25, 1e300]),
    "ring": np.array([7, 65535], dtype=np.uint16),
}


def test_binary_by_hand(tmp_path: Path) -> None:
    assert_equal(read_pcd(pcd(tmp_path, BODY)), EXPECTED)


def test_ascii_by_hand(tmp_path: Path) -> None:
    path = pcd(tmp_path, b"1.5 2.25 7\n-3 1e300 65535\n", DATA="ascii")
    assert_equal(read_pcd(path), EXPECTED)
    assert_equal(read_pcd(pcd(tmp_path, b"1.5\t2.25 7 \r\n-3 1e300 65535", DATA="ascii")), EXPECTED)


def test_compressed_by_hand(tmp_path: Path) -> None:
    """Fields one after another; 28 bytes as one run of literals (control byte 27)."""
    body = struct.pack("<ff", 1.5, -3) + struct.pack("<dd", 2.25, 1e300) + struct.pack("<HH", 7, 65535)
    stream = bytes([27]) + body
    path = pcd(tmp_path, struct.pack("<II", len(stream), len(body)) + stream, DATA="binary_compressed")
    assert_equal(read_pcd(path), EXPECTED)


def test_nine_fields_as_k_radar_writes_them(tmp_path: Path) -> None:
    text = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        "FIELDS x y z intensity t reflectivity ring ambient range\nSIZE 4 4 4 4 4 2 1 2 4\nTYPE F F F F U U U U U\n"
        "COUNT 1 1 1 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n"
        "1.5 -2 0.25 33 99991232 12 127 4 25000\n0 0 0 0 4294967295 65535 255 0 0\n"
    )
    (tmp_path / "os2-64_00001.pcd").write_text(text)
    found = read_pcd(tmp_path / "os2-64_00001.pcd")
    assert list(found) == ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range"]
    assert found["t"].tolist() == [99991232, 4294967295]
    assert [found[name].dtype.str for name in ("x", "t", "reflectivity", "ring")] == ["<f4", "<u4", "<u2", "|u1"]


def test_ascii_keeps_all_64_bits_of_time_stamps(tmp_path: Path) -> None:
    stamps = np.array([1558131117608556769, -(2**63), 2**63 - 1])
    write_pcd(tmp_path / "a.pcd", {"time_ns": stamps, "id": stamps.astype(np.uint64)}, encoding="ascii")
    assert_equal(read_pcd(tmp_path / "a.pcd"), {"time_ns": stamps, "id": stamps.astype(np.uint64)})


@pytest.mark.parametrize("encoding", ["binary", "ascii", "binary_compressed"])
def test_padding_is_left_out_and_counts_become_columns(tmp_path: Path, encoding: str) -> None:
    layout = {"FIELDS": "x _ f _ y", "SIZE": "4 1 4 2 1", "TYPE": "F U F U I", "COUNT": "1 3 2 1 1"}
    expected = {
        "x": np.array([1, 4], dtype=np.float32),
        "f": np.array([[2, 3], [5, 6]], dtype=np.float32),
        "y": np.array([-1, -2], dtype=np.int8),
    }
    if encoding == "ascii":
        body = b"1 9 9 9 2 3 9 -1\n4 9 9 9 5 6 9 -2\n"
    elif encoding == "binary":
        body = struct.pack("<f3BffHb", 1, 9, 9, 9, 2, 3, 9, -1) + struct.pack("<f3BffHb", 4, 9, 9, 9, 5, 6, 9, -2)
    else:
        padded = struct.pack("<ff6Bffff2Hbb", 1, 4, *[9] * 6, 2, 3, 5, 6, 9, 9, -1, -2)
        stream = compress_lzf(padded)
        body = struct.pack("<II", len(stream), len(padded)) + stream
    assert_equal(read_pcd(pcd(tmp_path, body, DATA=encoding, **layout)), expected)
    if encoding == "binary_compressed":  # as the Point Cloud Library writes it: without the padding
        dense = struct.pack("<ffffffbb", 1, 4, 2, 3, 5, 6, -1, -2)
        stream = compress_lzf(dense)
        body = struct.pack("<II", len(stream), len(dense)) + stream
        assert_equal(read_pcd(pcd(tmp_path, body, DATA=encoding, **layout)), expected)


def test_headers_of_older_versions(tmp_path: Path) -> None:
    """v0.5 lacks HEIGHT, VIEWPOINT, COUNT; the oldest say COLUMNS and take float32 for granted."""
    path = pcd(tmp_path, BODY, VERSION=".5", COUNT=None, HEIGHT=None, VIEWPOINT=None)
    assert_equal(read_pcd(path), EXPECTED)
    assert_equal(read_pcd(pcd(tmp_path, BODY, POINTS=None)), EXPECTED)
    (tmp_path / "old.pcd").write_text("COLUMNS x y\nPOINTS 1\nDATA ascii\n1 2\n")
    assert {name: array.dtype.str for name, array in read_pcd(tmp_path / "old.pcd").items()} == {"x": "<f4", "y": "<f4"}


def test_organised_clouds_keep_their_missing_points(tmp_path: Path) -> None:
    path = pcd(tmp_path, b"nan 0 1\n2 0 1\n3 0 1\nnan nan 1\n", DATA="ascii", WIDTH="2", HEIGHT="2", POINTS="4")
    assert np.isnan(read_pcd(path)["x"]).tolist() == [True, False, False, True]


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_clouds_without_points(tmp_path: Path, encoding: str) -> None:
    empty = {"x": np.zeros(0, dtype=np.float32), "normal": np.zeros((0, 3))}
    write_pcd(tmp_path / "a.pcd", empty, encoding=encoding)
    assert_equal(read_pcd(tmp_path / "a.pcd"), empty)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_round_trip_is_bit_exact(tmp_path: Path, rng: np.random.Generator, encoding: str) -> None:
    fields = {
        "x": rng.normal(size=500).astype(np.float32) * 1e20,
        "y": rng.normal(size=500) * 1e-200,
        "normal": rng.normal(size=(500, 3)).astype(np.float32),
        "ring": rng.integers(0, 2**16, 500).astype(np.uint16),
        "id": rng.integers(-(2**62), 2**62, 500),
        "valid": (rng.random(500) > 0.5).astype(np.uint8),
        "swapped": rng.normal(size=500).astype(">f4"),
    }
    write_pcd(tmp_path / "a.pcd", fields, encoding=encoding)
    assert_equal(read_pcd(tmp_path / "a.pcd"), {**fields, "swapped": fields["swapped"].astype("<f4")})


def test_the_written_header_is_version_0_7(tmp_path: Path) -> None:
    write_pcd(
        tmp_path / "a.pcd", {"x": np.array([1.5]), "mask": np.array([True]), "v": np.ones((1, 2), dtype=np.int16)}
    )
    text, body = (tmp_path / "a.pcd").read_bytes().split(b"DATA binary\n")
    assert text.decode().splitlines() == [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x mask v",
        "SIZE 8 1 2",
        "TYPE F U I",
        "COUNT 1 1 2",
        "WIDTH 1",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        "POINTS 1",
    ]
    assert body == struct.pack("<dBhh", 1.5, 1, 1, 1)


@pytest.mark.parametrize(
    ("changes", "where", "message"),
    [
        ({"DATA": None}, "line 10", "a header that ends with DATA, found the end of the file"),
        ({"FIELDS": None}, "line 9", "FIELDS to be names.*found no such line"),
        ({"FIELDS": "x x ring"}, "line 2", "names that differ"),
        ({"FIELDS": "x y"}, "line 3", "SIZE to be 2 values, one a field, found 4 8 2"),
        ({"SIZE": "4 3 2"}, "line 3", "SIZE to be I or U of 1, 2, 4, 8 bytes"),
        ({"SIZE": "4 8 99999999999999999999"}, "line 3", "SIZE to be"),
        ({"SIZE": "2 8 2"}, "line 3", "F of 4, 8"),
        ({"TYPE": "F F X"}, "line 4", "TYPE to be I or U"),
        ({"TYPE": "F F"}, "line 4", "TYPE to be 3 values"),
        ({"COUNT": "1 0 1"}, "line 5", "COUNT to be numbers from 1 to 65536"),
        ({"COUNT": "1 -1 1"}, "line 5", "COUNT to be"),
        ({"COUNT": "1 1 4000000000"}, "line 5", "COUNT to be"),
        ({"WIDTH": "3"}, "line 9", "POINTS to be WIDTH x HEIGHT, found 2 points for 3 x 1"),
        ({"WIDTH": "two"}, "line 6", "WIDTH to be one whole number, found two"),
        ({"WIDTH": "2 2"}, "line 6", "WIDTH to be one whole number"),
        ({"WIDTH": None, "POINTS": None}, "line 8", "WIDTH or POINTS, found neither"),
        ({"POINTS": "-2"}, "line 9", "POINTS to be one whole number, found -2"),
        ({"POINTS": "9" * 30, "WIDTH": "9" * 30}, "line 6", "WIDTH to be one whole number"),
        ({"DATA": "binary_zip"}, "line 10", "DATA to be ascii or binary or binary_compressed"),
        ({"VERSION": "0.7\nVERSION 0.7"}, "line 2", "one of FIELDS.*found b'VERSION 0.7'"),
        ({"VIEWPOINT": "0\nSURPRISE 1"}, "line 9", "one of POINTS, DATA, found b'SURPRISE 1'"),
        (
            {"POINTS": "1" + "0" * 9, "WIDTH": "1" + "0" * 9},
            "byte 142",
            "14000000000 bytes .*found 28 bytes. .*truncated",
        ),
        ({"POINTS": "1", "WIDTH": "1"}, "byte 124", "14 bytes .*found 28 bytes. .*over-long"),
        ({"COUNT": "1 1 65536"}, "line 5", "at most 256 numbers per point, found 65538"),
        ({"COUNT": "1 1 250"}, "byte 126", "2 points of 512 bytes.*found 28 bytes"),
    ],
)
def test_headers_that_lie(tmp_path: Path, changes: dict[str, str | None], where: str, message: str) -> None:
    with pytest.raises(FileFormatError, match=message) as caught:
        read_pcd(pcd(tmp_path, BODY, **changes))
    assert caught.value.where == where


def test_an_endless_header_is_not_searched_to_its_end(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(b"# no end in sight\n" * 100_000)
    with pytest.raises(FileFormatError, match="65536 bytes without it"):
        read_pcd(tmp_path / "a.pcd")
    (tmp_path / "a.pcd").write_bytes(b"")
    with pytest.raises(
        FileFormatError, match="line 1: expected a header that ends with DATA, found the end of the file"
    ):
        read_pcd(tmp_path / "a.pcd")


@pytest.mark.parametrize(
    ("body", "where", "message"),
    [
        (b"1 2 3\n", "line 11", "2 points, found 1 lines"),
        (b"1 2 3\n4 5 6\n7 8 9\n", "line 11", "2 points, found 3 lines"),
        (b"1 2\n4 5\n", "line 11", "3 columns, found 2"),
        (b"1 2 3\n4 5\n", "line 12", "3 columns, found 2 in '4 5'"),
        (b"1 2 3\n4 x 6\n", "line 12", "number .float64., found 'x'"),
        (b"1 2 3\n4 5 65536\n", "line 12", "number .uint16., found '65536'"),
        (b"1 2 3\n4 5 -1\n", "line 12", "number .uint16., found '-1'"),
        (b"1 2 3\n4 5 6.5\n", "line 12", "number .uint16., found '6.5'"),
        (b"1 2 3\n4 5 nan\n", "line 12", "number .uint16., found 'nan'"),
        (b"", "line 11", "2 points, found 0 lines"),
    ],
)
def test_ascii_faults(tmp_path: Path, body: bytes, where: str, message: str) -> None:
    with pytest.raises(FileFormatError, match=message) as caught:
        read_pcd(pcd(tmp_path, body, DATA="ascii"))
    assert caught.value.where == where


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"", "8 bytes with both sizes, found 0 bytes"),
        (b"\0" * 7, "8 bytes with both sizes, found 7 bytes"),
        (struct.pack("<II", 100, 28) + b"\0" * 20, r"100 bytes \(the compressed size\), found 20 bytes.*truncated"),
        (struct.pack("<II", 2, 28) + b"\0ab", r"2 bytes \(the compressed size\), found 3 bytes.*over-long"),
        (struct.pack("<II", 2, 29) + b"\0a", "2 points of 14 bytes.*found 29 bytes"),
        (struct.pack("<II", 0, 28), "at most 88 times 0, found 28 bytes"),
        (struct.pack("<II", 2, 28) + b"\0a", "28 bytes in LZF, found byte 2: 1 bytes came out instead of 28"),
        (struct.pack("<II", 2, 28) + b"\x1fa", "28 bytes in LZF, found byte 2"),
        (struct.pack("<II", 2, 28) + b"\x20\0", "a copy from 1 bytes before the beginning"),
        (struct.pack("<II", 3, 28) + b"\0a\xe0", "the stream ends within a token"),
        (struct.pack("<II", 5, 28) + b"\0a\xe0\xff\0", "265 bytes came out instead of 28"),
    ],
)
def test_compressed_faults(tmp_path: Path, body: bytes, message: str) -> None:
    with pytest.raises(FileFormatError, match=message):
        read_pcd(pcd(tmp_path, body, DATA="binary_compressed"))


def test_a_small_file_cannot_claim_a_large_body(tmp_path: Path) -> None:
    points = str(200_000_000)
    size = struct.pack("<II", 2, 2_800_000_000)
    with pytest.raises(FileFormatError, match="at most 88 times 2, found 2800000000 bytes"):
        read_pcd(pcd(tmp_path, size + b"\0a", DATA="binary_compressed", POINTS=points, WIDTH=points))


def test_zeros_up_to_a_memory_page_may_follow(tmp_path: Path) -> None:
    assert_equal(read_pcd(pcd(tmp_path, BODY + bytes(3000))), EXPECTED)
    with pytest.raises(FileFormatError, match="over-long"):
        read_pcd(pcd(tmp_path, BODY + bytes(70_000)))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "at least one field"),
        ({"x": np.zeros(2), "y": np.zeros(3)}, r"all of one length, got lengths \[2, 3\]"),
        ({"x": np.zeros(2, dtype=np.float16)}, "expected numbers .* in 'x', got float16"),
        ({"x": np.array(["a"])}, "expected numbers"),
        ({"x": np.zeros((2, 2, 2))}, "expected numbers of shape"),
        ({"x y": np.zeros(2)}, "field name without blanks"),
        ({"x\nDATA": np.zeros(2)}, "field name without blanks"),
        ({"_": np.zeros(2)}, "field name"),
        ({"": np.zeros(2)}, "field name"),
        ({"größe": np.zeros(2)}, "field name"),
    ],
)
def test_what_pcd_cannot_hold_is_not_written(tmp_path: Path, fields: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        write_pcd(tmp_path / "a.pcd", fields)
    with pytest.raises(ValueError, match="encoding to be one of ascii"):
        write_pcd(tmp_path / "a.pcd", {"x": np.zeros(1)}, encoding="zip")
    assert list(tmp_path.iterdir()) == []


def test_real_files_of_the_point_cloud_library(shared_real: Path, tmp_path: Path) -> None:
    """Ring numbers and time stamps are only plausible if every byte landed where it belongs."""
    paths = sorted((shared_real / "pcd").rglob("*.pcd"))
    assert paths
    for path in paths:
        fields = read_pcd(path)
        assert len({len(array) for array in fields.values()}) == 1
        assert max(np.abs(fields[axis]).max() for axis in "xyz") < 300
        assert 0 <= fields["intensity"].min() <= fields["intensity"].max() <= 255
        if "ring" in fields:
            assert fields["ring"].max() < 64
            assert 0.05 < np.ptp(fields["timestamp"]) < 0.2
        write_pcd(tmp_path / "a.pcd", fields, encoding="binary")
        assert_equal(read_pcd(tmp_path / "a.pcd"), fields)


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        (b"", b""),
        (b"\x02abc", b"abc"),
        (b"\x00a\x20\x00", b"aaaa"),
        (b"\x01ab\x60\x01", b"abababa"),
        (b"\x00a\xe0\x00\x00", b"a" * 10),
        (b"\x00a\xe0\xff\x00", b"a" * 265),
        (b"\x03abcd\x20\x03\x00x", b"abcdabcx"),
    ],
)
def test_lzf_streams_by_hand(stream: bytes, expected: bytes) -> None:
    assert decompress_lzf(stream, len(expected)) == expected


@settings(max_examples=200, deadline=None)
@given(
    st.binary(max_size=300) | st.lists(st.sampled_from([b"ab", b"abc", b"\0" * 40, b"xyz"]), max_size=200).map(b"".join)
)
def test_lzf_round_trip(data: bytes) -> None:
    stream = compress_lzf(data)
    assert len(stream) <= len(data) + (len(data) + 31) // 32
    assert decompress_lzf(stream, len(data)) == data


def test_lzf_copies_reach_exactly_8192_bytes_back(rng: np.random.Generator) -> None:
    block = rng.bytes(64)
    for gap, found in ((8192 - 64, True), (8193 - 64, False)):
        data = block + rng.bytes(gap) + block
        stream = compress_lzf(data)
        assert decompress_lzf(stream, len(data)) == data
        assert (len(stream) < len(data) * 33 // 32 - 40) is found


def test_lzf_expands_at_most_88_times() -> None:
    stream = compress_lzf(bytes(1_000_000))
    assert 80 < 1_000_000 / len(stream) <= LZF_MAX_EXPANSION


def test_an_organised_cloud_has_pcls_eleven_header_lines(tmp_path: Path, rng: np.random.Generator) -> None:
    fields = {
        "x": rng.normal(0, 50, 12).astype(np.float32),
        "t": rng.integers(0, 1 << 32, 12, dtype=np.uint32),
        "ring": np.arange(12, dtype=np.uint8),
    }
    write_pcd(tmp_path / "a.pcd", fields, encoding="ascii", height=3)
    lines = (tmp_path / "a.pcd").read_text("ascii").splitlines()
    assert lines[:11] == [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x t ring",
        "SIZE 4 4 1",
        "TYPE F U U",
        "COUNT 1 1 1",
        "WIDTH 4",
        "HEIGHT 3",
        "VIEWPOINT 0 0 0 1 0 0 0",
        "POINTS 12",
        "DATA ascii",
    ]
    assert len(lines) == 11 + 12
    back = read_pcd(tmp_path / "a.pcd")
    assert all(back[name].dtype == fields[name].dtype and (back[name] == fields[name]).all() for name in fields)
    with pytest.raises(ValueError, match="a height that divides 12 points, got 5"):
        write_pcd(tmp_path / "b.pcd", fields, height=5)


def test_padding_of_no_bytes_is_passed_over(tmp_path):
    """SUSTechPOINTS' sample names a padding field with COUNT 0."""
    head = (
        b"VERSION 0.7\nFIELDS x _ y _ z\nSIZE 4 1 4 1 4\nTYPE F U F U F\nCOUNT 1 0 1 2 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n"
    )
    path = tmp_path / "a.pcd"
    path.write_bytes(head + b"DATA binary\n" + np.float32([1, 2]).tobytes() + b"\xff\xff" + np.float32([3]).tobytes())
    assert {name: values.tolist() for name, values in read_pcd(path).items()} == {"x": [1], "y": [2], "z": [3]}
    path.write_bytes(path.read_bytes().replace(b"COUNT 1 0 1", b"COUNT 0 1 1"))
    with pytest.raises(FileFormatError, match="COUNT"):
        read_pcd(path)
