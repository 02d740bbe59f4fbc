"""MATLAB v5 arrays, against SciPy and damaged in many ways."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from mat_elements import damaged, file, matrix

from farfield.errors import FileFormatError
from farfield.files.mat import read_mat, write_mat


@pytest.mark.parametrize("kind", ["f4", "f8", "u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8"])
@pytest.mark.parametrize("compress", [False, True])
def test_scipy_reads_what_is_written_and_so_do_we(
    tmp_path: Path, rng: np.random.Generator, kind: str, compress: bool
) -> None:
    array = (rng.normal(0, 50, (3, 5, 2, 7)) if kind[0] == "f" else rng.integers(0, 100, (3, 5, 2, 7))).astype(kind)
    for given in (array, np.asfortranarray(array), array[:, ::-1, :, ::-1]):
        write_mat(tmp_path / "a.mat", "arr_zyx", given, compress=compress)
        theirs = scipy.io.loadmat(tmp_path / "a.mat")["arr_zyx"]
        ours = read_mat(tmp_path / "a.mat", "arr_zyx")
        for back in (theirs, ours):
            assert back.dtype == given.dtype
            assert np.array_equal(back, given)


@pytest.mark.parametrize("compress", [False, True])
def test_we_read_what_scipy_writes(tmp_path: Path, rng: np.random.Generator, compress: bool) -> None:
    arrays = {"first": rng.normal(0, 1, (4, 3)), "other": np.arange(5, dtype=np.int16)[None], "none": np.zeros((0, 3))}
    scipy.io.savemat(tmp_path / "a.mat", arrays | {"text": "hello", "cell": {"a": 1}}, do_compression=compress)
    for name, array in arrays.items():
        back = read_mat(tmp_path / "a.mat", name)
        assert back.dtype == array.dtype
        assert np.array_equal(back, array)
    with pytest.raises(FileFormatError, match="an array 'absent', found first, other, none, text, cell"):
        read_mat(tmp_path / "a.mat", "absent")
    with pytest.raises(FileFormatError, match="a real numeric array, found class 4"):
        read_mat(tmp_path / "a.mat", "text")


def test_matlabs_own_files(shared_real: Path) -> None:
    """MATLAB stores whole doubles as small integers; they come back as doubles."""
    azimuth = read_mat(shared_real / "kradar" / "info_arr.mat", "arrAzimuth")
    assert azimuth.dtype == np.float64
    assert azimuth.tolist() == [list(range(-53, 54))]
    assert read_mat(shared_real / "kradar" / "info_arr.mat", "arrRange")[0, -1] == 118.037109375


def test_the_same_array_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_mat(tmp_path / name, "x", np.arange(6.0).reshape(2, 3), compress=True)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("1a", np.zeros((2, 2))),
        ("a b", np.zeros((2, 2))),
        ("a" * 64, np.zeros((2, 2))),
        ("a", np.zeros(3)),
        ("a", np.zeros((2, 2), dtype=complex)),
        ("a", np.zeros((2, 2), dtype=object)),
    ],
)
def test_what_the_format_cannot_hold_is_refused(tmp_path: Path, name: str, array: np.ndarray) -> None:
    with pytest.raises(ValueError, match="write_mat: expected"):
        write_mat(tmp_path / "a.mat", name, array)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (matrix((2**31 - 1,) * 4, bytes(8)), "numbers of 8 bytes, found 8 bytes"),
        (matrix((-1, -1), bytes(8)), "-1 x -1 numbers"),
        (matrix((1,), bytes(8)), "2 to 32 dimensions"),
        (matrix((1, 1), bytes(8), claimed=1 << 30), "1073741824 bytes of an element, found 8 bytes"),
        (matrix((1, 1), bytes(8), kind=77), "a real numeric array"),
        (struct.pack("<II", 14, 1 << 31) + bytes(64), "The file is truncated"),
        (struct.pack("<II", 15, 8) + bytes(8), "a compressed array"),
        (struct.pack("<II", 14, 8) + bytes(8), "flags, dimensions and a name"),
        (struct.pack("<HHI", 1, 9, 0), "at most 4 bytes in a small element"),
        (b"", "an array 'x', found no array"),
    ],
)
def test_claims_are_compared_with_what_is_there(tmp_path: Path, element: bytes, message: str) -> None:
    with pytest.raises(FileFormatError, match=message):
        read_mat(file(tmp_path / "a.mat", element), "x")


def test_a_small_file_cannot_expand_without_bound(tmp_path: Path) -> None:
    huge = zlib.compress(matrix((1 << 13, 1 << 13), bytes(1 << 26), kind=2), 9)
    path = file(tmp_path / "a.mat", struct.pack("<II", 15, len(huge)), huge)
    assert read_mat(path, "x").shape == (1 << 13, 1 << 13)
    with pytest.raises(FileFormatError, match="at most 1048576 bytes"):
        read_mat(path, "x", max_bytes=1 << 20)
    liar = zlib.compress(struct.pack("<II", 14, 1 << 29) + bytes(64))
    with pytest.raises(FileFormatError, match="1032-fold expansion"):
        read_mat(file(tmp_path / "b.mat", struct.pack("<II", 15, len(liar)), liar), "x")


def test_other_kinds_of_file_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(b"\x89HDF\r\n\x1a\n".ljust(200))
    with pytest.raises(FileFormatError, match=r"found a v7.3 \(HDF5\) file. Save it in MATLAB with -v7"):
        read_mat(tmp_path / "a.mat", "x")
    (tmp_path / "a.mat").write_bytes(b"")
    with pytest.raises(FileFormatError, match="header of 128 bytes"):
        read_mat(tmp_path / "a.mat", "x")


def test_damaged_files_raise_nothing_else(tmp_path: Path, rng: np.random.Generator) -> None:
    """500 files: cut short, with bytes changed, with random bytes behind a good header."""
    array, refused = rng.normal(0, 1, (4, 3, 5)).astype(np.float32), 0
    for path, _ in damaged(tmp_path, array, 500, rng):
        try:
            assert read_mat(path, "x", max_bytes=1 << 20).nbytes <= 1 << 20
        except FileFormatError:
            refused += 1
    assert refused > 300
