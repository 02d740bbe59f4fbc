"""NumPy's files, read without trust."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.npy import read_npy, write_npy


@pytest.mark.parametrize("kind", ["f2", "f4", "f8", "i1", "u2", "i8", "?", ">f4"])
@pytest.mark.parametrize("shape", [(), (0, 4), (5,), (3, 4, 2)])
def test_round_trip_and_numpys_own(tmp_path: Path, rng: np.random.Generator, kind: str, shape: tuple[int, ...]) -> None:
    array = rng.integers(0, 2, shape).astype(kind)
    for given in (array, np.asfortranarray(array).reshape(shape)):
        write_npy(tmp_path / "a.npy", given)
        np.save(tmp_path / "b.npy", given)
        for back in (np.load(tmp_path / "a.npy", allow_pickle=False), read_npy(tmp_path / "b.npy")):
            assert back.dtype == given.dtype
            assert back.shape == shape
            assert np.array_equal(back, given)


def header(text: str, data: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + data


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY\x03\x00",
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 1000)}\n", bytes(8)),
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, -1)}\n", bytes(8)),
        header("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}\n", bytes(8)),
        header("{'descr': '<U2', 'fortran_order': False, 'shape': (1,)}\n", bytes(8)),
        header("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}\n", bytes(8)),
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}\n", bytes(9)),
        header("{'descr': '|b1', 'fortran_order': False, 'shape': (2,)}\n", b"\x00\x07"),
        header("(" * 3000 + "\n"),
        header("__import__('os').getcwd()\n"),
    ],
)
def test_damage_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(FileFormatError):
        read_npy(tmp_path / "a.npy")


def test_damaged_files_raise_nothing_else(tmp_path: Path, rng: np.random.Generator) -> None:
    write_npy(tmp_path / "a.npy", rng.normal(0, 1, (7, 4)))
    good, refused = (tmp_path / "a.npy").read_bytes(), 0
    for case in range(300):
        data = bytearray(good)
        if case % 3 == 0:
            data = data[: int(rng.integers(0, len(data)))]
        else:
            for place in rng.integers(0, 100, 1 + case % 5):
                data[int(place)] = int(rng.integers(0, 256))
        (tmp_path / "a.npy").write_bytes(bytes(data))
        try:
            assert read_npy(tmp_path / "a.npy").nbytes <= len(data)
        except FileFormatError:
            refused += 1
    assert refused > 200


def test_pickles_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected numbers"):
        write_npy(tmp_path / "a.npy", np.array([{}], dtype=object))


def test_sides_beside_a_zero_are_bounded_too(tmp_path: Path) -> None:
    write_npy(tmp_path / "a.npy", np.zeros((0, 3, 10, 10)))
    data = (tmp_path / "a.npy").read_bytes()
    for shape in ("(0, 4611686018427387903, 9)", "(4294967296, 4294967296, 0)"):
        header = data[10:128].replace(b"(0, 3, 10, 10)", shape.encode()).rstrip().ljust(117) + b"\n"
        (tmp_path / "b.npy").write_bytes(data[:10] + header[: len(data) - 10])
        with pytest.raises(FileFormatError, match=r"found numbers of shape"):
            read_npy(tmp_path / "b.npy")
