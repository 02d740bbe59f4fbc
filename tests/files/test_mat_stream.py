"""MATLAB arrays read in blocks: the same numbers as SciPy reads whole, and damaged files in many ways."""

import struct
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from mat_elements import damaged, file, matrix, packed

from farfield.errors import FileFormatError
from farfield.files.mat import open_mat, read_mat, write_mat


def read_in_blocks(path: Path, name: str, columns: int, **options: int) -> np.ndarray:
    with open_mat(path, name, **options) as stream:
        blocks = [block.copy() for block in stream.blocks(columns)]
        assert all(len(block) == columns for block in blocks[:-1])
        rows = np.concatenate([np.empty((0, stream.shape[0]), stream.dtype), *blocks])
        return rows.T.reshape(stream.shape, order="F")


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("columns", [1, 9, 70, 1000])
def test_blocks_are_the_file_in_its_order(tmp_path: Path, rng: np.random.Generator, compress: bool, columns: int):
    array = rng.normal(0, 50, (8, 5, 2, 7))
    others = {"first": np.zeros((3, 3)), "arrDREA": array, "text": "hello", "cell": {"a": 1}}
    scipy.io.savemat(tmp_path / "a.mat", others, do_compression=compress)
    assert np.array_equal(read_in_blocks(tmp_path / "a.mat", "arrDREA", columns), array)
    with pytest.raises(FileFormatError, match="an array 'absent', found first, arrDREA, text, cell"):
        read_in_blocks(tmp_path / "a.mat", "absent", columns)
    with pytest.raises(FileFormatError, match="a real numeric array, found class 4"):
        read_in_blocks(tmp_path / "a.mat", "text", columns)


@pytest.mark.parametrize("kind", ["f4", "f8", "u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8"])
@pytest.mark.parametrize("compress", [False, True])
def test_every_kind_of_number_and_size(tmp_path: Path, rng: np.random.Generator, kind: str, compress: bool):
    """Sizes that fill a tag (4 bytes), need padding, or nothing at all."""
    for shape in ((1, 1), (1, 3), (3, 5), (0, 4), (4, 0), (2, 3, 4)):
        array = rng.integers(0, 100, shape).astype(kind)
        scipy.io.savemat(tmp_path / "a.mat", {"x": array}, do_compression=compress)
        back = read_in_blocks(tmp_path / "a.mat", "x", 2)
        assert np.array_equal(back, array)
        write_mat(tmp_path / "b.mat", "x", array, compress=compress)
        assert np.array_equal(read_in_blocks(tmp_path / "b.mat", "x", 3), array)


def test_matlabs_own_file_with_shrunk_doubles(shared_real: Path):
    path = shared_real / "kradar" / "info_arr.mat"
    for name in ("arrAzimuth", "arrElevation", "arrRange"):
        assert np.array_equal(read_in_blocks(path, name, 10), read_mat(path, name))


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (matrix((2**31 - 1,) * 4, bytes(8)), "numbers of 8 bytes, found 8 bytes"),
        (matrix((-1, -1), bytes(8)), "-1 x -1 numbers"),
        (matrix((1,), bytes(8)), "2 to 32 dimensions"),
        (matrix((1, 1), bytes(8), kind=77), "a real numeric array"),
        (matrix((1, 1), bytes(8), flags=0x0806), "a real numeric array"),
        (matrix((1, 2), bytes(8), claimed=16), "16 bytes, 16 with the tag"),
        (matrix((1,) * 80, bytes(8)), "256 bytes of an array's header"),
        (struct.pack("<II", 14, 1 << 31) + bytes(64), "elements?, found 64 bytes. The file may be truncated"),
        (struct.pack("<II", 15, 8) + bytes(8), "a compressed array"),
        (struct.pack("<II", 14, 8) + bytes(8), "more bytes"),
        (packed(matrix((1, 2), bytes(8), claimed=16)), "16 bytes, 16 with the tag"),
        (packed(struct.pack("<II", 14, 1 << 29) + bytes(64)), "1032-fold expansion"),
        (packed(struct.pack("<II", 1, 8) + bytes(8)), "type 1, 8 bytes"),
        (packed(matrix((1, 100), bytes(800)) + b"more"), "the end of the array, found more bytes"),
        (b"", "an array 'x', found no array"),
    ],
)
def test_claims_are_compared_with_what_is_there(tmp_path: Path, element: bytes, message: str):
    with pytest.raises(FileFormatError, match=message.replace("elements?", "element")):
        read_in_blocks(file(tmp_path / "a.mat", element), "x", 10)


def test_limits_hold_before_anything_is_allocated(tmp_path: Path):
    huge = packed(matrix((1 << 13, 1 << 13), bytes(1 << 26), kind=2))
    path = file(tmp_path / "a.mat", huge)
    with open_mat(path, "x") as stream:
        assert sum(len(block) for block in stream.blocks(1 << 10)) == 1 << 13
    with pytest.raises(FileFormatError, match="at most 1048576 bytes"):
        read_in_blocks(path, "x", 10, max_bytes=1 << 20)
    with pytest.raises(FileFormatError, match="at most 1024 bytes"):
        read_in_blocks(path, "x", 10, max_bytes=1 << 10)


def test_a_compressed_array_with_a_wrong_checksum_is_refused_at_its_end(tmp_path: Path, rng: np.random.Generator):
    write_mat(tmp_path / "a.mat", "x", rng.normal(0, 1, (4, 300)), compress=True)
    data = bytearray((tmp_path / "a.mat").read_bytes())
    data[-1] ^= 1
    (tmp_path / "a.mat").write_bytes(bytes(data))
    with pytest.raises(FileFormatError, match="expected checksum"):
        read_in_blocks(tmp_path / "a.mat", "x", 10)


def test_a_caller_may_stop_early(tmp_path: Path, rng: np.random.Generator):
    array = rng.normal(0, 1, (4, 5000))
    write_mat(tmp_path / "a.mat", "x", array, compress=True)
    with open_mat(tmp_path / "a.mat", "x") as stream:
        for block in stream.blocks(100):
            assert np.array_equal(block, array.T[:100])
            break


def test_damaged_files_raise_nothing_else(tmp_path: Path, rng: np.random.Generator):
    """400 files; a compressed array that is read to its end is the one that was written."""
    array, refused = rng.normal(0, 1, (4, 3, 5)).astype(np.float32), 0
    for path, compressed in damaged(tmp_path, array, 400, rng):
        try:
            back = read_in_blocks(path, "x", 4, max_bytes=1 << 20)
            assert back.nbytes <= 1 << 20
            assert not compressed or np.array_equal(back, array)
        except FileFormatError:
            refused += 1
    assert refused > 250
