"""NumPy's ``.npy`` files of plain numbers, read without pickle and without trust in the header's sizes."""

import math
import os
import tokenize
import warnings
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import open_atomic
from farfield.files.limits import MAX_BYTES, MAX_NUMBERS, is_addressable, open_file
from farfield.files.stand_ins import check_itself

_MAX_HEADER_BYTES = 4096


def read_npy(path: Path | str, *, fields: bool = False, max_bytes: int = MAX_BYTES) -> Shaped[np.ndarray, "..."]:
    """Read an array of integers, floats or booleans.

    Args:
        path: The file.
        fields: Take fields of such numbers by name as well, as of a structured array.
        max_bytes: Largest file that is accepted.

    Returns:
        The array with the shape, dtype and memory order that the file has.

    Raises:
        FileFormatError: If the file is truncated, over-long, damaged, or holds anything but numbers.
    """
    check_itself(path)
    with open_file(path, max_bytes=max_bytes) as handle:
        return _read(handle, os.fstat(handle.fileno()).st_size, path, fields)


def parse_npy(data: bytes, path: Path | str, *, fields: bool = False) -> Shaped[np.ndarray, "..."]:
    """An array of the bytes of such a file, as :func:`read_npy`.

    Raises:
        FileFormatError: If they are truncated, over-long, damaged, or hold anything but numbers.
    """
    return _read(BytesIO(data), len(data), path, fields)


def _read(handle: BinaryIO | BytesIO, size: int, path: Path | str, fields: bool) -> Shaped[np.ndarray, "..."]:
    shape, fortran, dtype = _header(path, handle, fields)
    start = handle.tell()
    if math.prod(shape) * dtype.itemsize != size - start:
        expected = f"numbers of shape {shape} and dtype {dtype}"
        raise FileFormatError(path, where=f"byte {start}", expected=expected[:200], got=f"{size - start} bytes")
    values = np.empty(math.prod(shape), dtype=dtype)
    if handle.readinto(values.view(np.uint8).data) != values.nbytes:  # type: ignore[union-attr]
        raise FileFormatError(path, where=f"byte {start}", expected=f"{values.nbytes} bytes", got="fewer")
    if dtype.kind == "b" and (values.view(np.uint8) > 1).any():
        raise FileFormatError(path, where=f"byte {start}", expected="booleans", got="bytes above 1")
    return values.reshape(shape, order="F" if fortran else "C")


def _header(path: Path | str, handle: BinaryIO | BytesIO, fields: bool) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, order and number type, after which the file stands at the numbers."""
    try:
        version = np.lib.format.read_magic(handle)
        if version not in ((1, 0), (2, 0), (3, 0)):
            raise ValueError(f"version {version}")
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of headers that Python 2 wrote, which are read all the same
            shape, fortran, dtype = reader(handle, max_header_size=_MAX_HEADER_BYTES)
        if dtype.names is not None and version == (3, 0):  # whose names are in UTF-8
            dtype.names = tuple(name.encode("latin1").decode("utf-8") for name in dtype.names)
        kinds = {"": dtype} if dtype.names is None or not fields else {n: dtype[n].base for n in dtype.names}
        wrong = next((name for name, kind in kinds.items() if kind.kind not in "fiub" or kind.hasobject), None)
        if wrong is not None:
            raise ValueError(f"{wrong!r} of {kinds[wrong]}"[:200] if wrong else f"numbers of dtype {dtype}"[:200])
        if sum(math.prod(dtype[name].shape) for name in dtype.names or ()) > MAX_NUMBERS:
            raise ValueError(f"more than {MAX_NUMBERS} numbers per point")
        if not is_addressable(shape, dtype.itemsize):
            raise ValueError(f"numbers of shape {shape} and dtype {dtype}"[:200])
    except (ValueError, TypeError, SyntaxError, KeyError, RecursionError, MemoryError, tokenize.TokenError) as error:
        expected = f"a header of NumPy's format 1.0 to 3.0, of {'fields of ' if fields else ''}numbers"
        raise FileFormatError(path, where="byte 0", expected=expected, got=str(error)[:120]) from error
    return shape, fortran, dtype


def write_npy(path: Path | str, array: Shaped[np.ndarray, "..."]) -> None:
    """Write an array of numbers, all or nothing.

    Raises:
        ValueError: If the array holds anything but integers, floats or booleans.
    """
    if array.dtype.kind not in "fiub":
        raise ValueError(f"write_npy: expected numbers, got dtype {array.dtype}")
    with open_atomic(path) as handle:
        np.lib.format.write_array(handle, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)
