"""NumPy's ``.npy`` files of plain numbers, read without pickle and without trust in the header's sizes."""

import io
import math
import tokenize
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import MAX_BYTES, open_atomic, read_bytes

_MAX_HEADER_BYTES = 4096


def read_npy(path: Path | str, *, max_bytes: int = MAX_BYTES) -> Shaped[np.ndarray, "..."]:
    """Read an array of integers, floats or booleans.

    Args:
        path: The file.
        max_bytes: Largest file that is accepted.

    Returns:
        The array with the shape, dtype and memory order that the file has.

    Raises:
        FileFormatError: If the file is truncated, over-long, damaged, or holds anything but numbers.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    handle = io.BytesIO(data[: _MAX_HEADER_BYTES + 16])
    try:
        version = np.lib.format.read_magic(handle)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"version {version}")
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of headers that Python 2 wrote, which are read all the same
            shape, fortran, dtype = reader(handle, max_header_size=_MAX_HEADER_BYTES)
        good = dtype.kind in "fiub" and not dtype.hasobject and all(0 <= side < 1 << 62 for side in shape)
    except (ValueError, TypeError, SyntaxError, KeyError, RecursionError, MemoryError, tokenize.TokenError) as error:
        expected = "a header of NumPy's format 1.0 or 2.0"
        raise FileFormatError(path, where="byte 0", expected=expected, got=str(error)[:120]) from error
    start = handle.tell()
    if not good or len(shape) > 32 or math.prod(shape) * dtype.itemsize != len(data) - start:
        expected = f"numbers of shape {shape} and dtype {dtype}"
        raise FileFormatError(path, where=f"byte {start}", expected=expected[:200], got=f"{len(data) - start} bytes")
    if dtype.kind == "b" and any(set(data[start:]) - {0, 1}):
        raise FileFormatError(path, where=f"byte {start}", expected="booleans", got="bytes above 1")
    values: np.ndarray = np.frombuffer(data, dtype=dtype, offset=start)
    return values.reshape(shape, order="F" if fortran else "C").copy(order="K")


def write_npy(path: Path | str, array: Shaped[np.ndarray, "..."]) -> None:
    """Write an array of numbers, all or nothing.

    Raises:
        ValueError: If the array holds anything but integers, floats or booleans.
    """
    if array.dtype.kind not in "fiub":
        raise ValueError(f"write_npy: expected numbers, got dtype {array.dtype}")
    with open_atomic(path) as handle:
        np.lib.format.write_array(handle, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)
