"""PLY in its three encodings, by hand: properties in any order, lists and other elements passed over, sizes checked."""

import struct
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.ply import read_ply
from farfield.frame.cloud import Cloud

HEAD = ["property uchar intensity", "property double x", "property float32 z", "property short ring", "property int y"]
VALUES = [(200, 1.5, -2.5, -3, 7), (0, 1e5 + 1 / 1024, 0.5, 31, -8)]
FACES = ["element face 2", "property list uchar int vertex_indices", "property uchar flags"]


def ply(tmp_path: Path, encoding: str, lines: list[str], body: bytes, end: str = "\n") -> Path:
    path = tmp_path / "cloud.ply"
    head = ["ply", f"format {encoding} 1.0", "comment straße", *lines, "end_header", ""]
    path.write_bytes(end.join(head).encode() + body)
    return path


def packed(order: str) -> bytes:
    return b"".join(struct.pack(f"{order}Bdfhi", *row) for row in VALUES)


def assert_values(columns: dict[str, np.ndarray]) -> None:
    assert {name: values.dtype.str[1:] for name, values in columns.items()} == {
        "intensity": "u1", "x": "f8", "z": "f4", "ring": "i2", "y": "i4",
    }  # fmt: skip
    for name, expected in zip(("intensity", "x", "z", "ring", "y"), zip(*VALUES, strict=True), strict=True):
        assert columns[name].tolist() == list(expected)
        assert columns[name].dtype.isnative


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(("encoding", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_binary_by_hand(tmp_path: Path, encoding: str, order: str, end: str) -> None:
    assert_values(read_ply(ply(tmp_path, encoding, ["element vertex 2", *HEAD], packed(order), end)))


def test_ascii_by_hand(tmp_path: Path) -> None:
    body = b"".join(" ".join(map(repr, row)).encode() + b"\n" for row in VALUES)
    assert_values(read_ply(ply(tmp_path, "ascii", ["element vertex 2", *HEAD], body)))
    assert_values(read_ply(ply(tmp_path, "ascii", ["element vertex 2", *HEAD], body.replace(b"\n", b"\r\n"), "\r\n")))


@pytest.mark.parametrize("lengths", [(3, 3), (3, 4), (0, 2)])
@pytest.mark.parametrize(("encoding", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_lists_before_and_behind_are_passed(
    tmp_path: Path, encoding: str, order: str, lengths: tuple[int, int]
) -> None:
    faces = b"".join(struct.pack(f"{order}B{n}iB", n, *range(n), 9) for n in lengths)
    before = ["element marks 1", "property list int float weights"]
    lines = [*before, "element vertex 2", *HEAD, *FACES]
    body = struct.pack(f"{order}i2f", 2, 0.5, 0.5) + packed(order) + faces
    assert_values(read_ply(ply(tmp_path, encoding, lines, body)))
    for wrong in (body[:-1], body + b"\0", body[1:]):
        with pytest.raises(FileFormatError):
            read_ply(ply(tmp_path, encoding, lines, wrong))


@pytest.mark.parametrize("lengths", [(2, 2), (1, 3)])
def test_lists_within_vertices_are_passed(tmp_path: Path, lengths: tuple[int, int]) -> None:
    lines = ["element vertex 2", HEAD[0], "property list uchar ushort seen", *HEAD[1:]]
    rows = zip(VALUES, lengths, strict=True)
    body = b"".join(struct.pack(f"<BB{n}H", row[0], n, *range(n)) + struct.pack("<dfhi", *row[1:]) for row, n in rows)
    assert_values(read_ply(ply(tmp_path, "binary_little_endian", lines, body)))
    rows = zip(VALUES, lengths, strict=True)
    text = "\n".join(" ".join(map(str, (row[0], n, *range(n), *row[1:]))) for row, n in rows)
    assert_values(read_ply(ply(tmp_path, "ascii", lines, text.encode())))
    with pytest.raises(FileFormatError, match="line 13"):  # a word less
        read_ply(ply(tmp_path, "ascii", lines, text.rpartition(" ")[0].encode()))


@pytest.mark.parametrize("count", [1, 3, 10**9, 10**17, 10**30])
@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_counts_that_lie_are_refused_before_anything_is_allocated(tmp_path: Path, encoding: str, count: int) -> None:
    body = packed("<") if encoding != "ascii" else b"1 2 3 4 5\n6 7 8 9 10\n"
    for lines in ([f"element vertex {count}", *HEAD], ["element vertex 2", *HEAD, f"element face {count}", *FACES[1:]]):
        with pytest.raises(FileFormatError):
            read_ply(ply(tmp_path, encoding, lines, body))


def test_a_list_that_lies_is_refused(tmp_path: Path) -> None:
    lines = ["element vertex 2", *HEAD, "element face 1", "property list int double v"]
    for length in (-1, 2**31 - 1, 2):
        path = ply(tmp_path, "binary_little_endian", lines, packed("<") + struct.pack("<id", length, 0.0))
        with pytest.raises(FileFormatError):
            read_ply(path)


@pytest.mark.parametrize(
    "lines",
    [
        ["element face 2", *HEAD],
        ["element vertex 2", *HEAD, HEAD[0]],
        ["element vertex 2", *HEAD, "element vertex 2", *HEAD],
        ["element vertex 2"],
        ["property float x", "element vertex 2"],
        ["element vertex -2", *HEAD],
        ["element vertex two", *HEAD],
        ["element vertex 2", "property half x"],
        ["element vertex 2", "property list float int x"],
        ["element vertex 2", *HEAD, "surprise"],
        ["element vertex 2", *(f"property uchar p{number}" for number in range(300))],
    ],
)
def test_headers_that_contradict_themselves_are_refused(tmp_path: Path, lines: list[str]) -> None:
    with pytest.raises(FileFormatError):
        read_ply(ply(tmp_path, "binary_little_endian", lines, packed("<")))


def test_other_encodings_and_no_end_are_refused(tmp_path: Path) -> None:
    for encoding in ("binary", "ascii 2.0 or"):
        with pytest.raises(FileFormatError, match="format"):
            read_ply(ply(tmp_path, encoding, ["element vertex 2", *HEAD], packed("<")))
    path = tmp_path / "cloud.ply"
    for data in (b"", b"ply", b"plyx\n", b"ply\nformat ascii 1.0\n" + b"comment x\n" * 10_000):
        path.write_bytes(data)
        with pytest.raises(FileFormatError):
            read_ply(path)


def test_a_cloud_of_cloudcompare_has_its_intensity(tmp_path: Path) -> None:
    lines = ["element vertex 2", *(f"property float {name}" for name in ("x", "y", "z", "scalar_Intensity"))]
    cloud = Cloud.from_file(ply(tmp_path, "binary_little_endian", lines, struct.pack("<8f", 1, 2, 3, 51, 4, 5, 6, 255)))
    assert cloud.points_m.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud.intensity is not None
    np.testing.assert_allclose(cloud.intensity, [0.2, 1.0])


def test_every_cut_of_a_file_is_refused(tmp_path: Path) -> None:
    faces = struct.pack("<B3iB", 3, 0, 1, 2, 9) * 2
    path = ply(tmp_path, "binary_little_endian", ["element vertex 2", *HEAD, *FACES], packed("<") + faces)
    data = path.read_bytes()
    for size in range(0, len(data), 3):
        path.write_bytes(data[:size])
        with pytest.raises(FileFormatError):
            read_ply(path)
