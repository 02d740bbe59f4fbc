"""NumPy's ``.npz`` archives of clouds: one table of rows, or one array a column; no pickle, no trust in sizes.

Taken are: one array of rows (n, 3 or more); one structured array; arrays of one length by name, ``x``, ``y`` and ``z``
among them; or one array of places (n, 3) with others of its length beside it, such as ``intensity``. In any other
archive it cannot be told which array is the cloud, and it is refused by name.
"""

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.limits import MAX_BYTES, allowed_bytes, check_name, check_numbers
from farfield.files.npy import parse_npy

_DAMAGES = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    IndexError,
)
_MOST_MEMBERS = 256
_FIX = (
    "Write one array of rows x, y, z, intensity, or one array a column by its name: np.savez(path, x=x, y=y, z=z, "
    "intensity=intensity)."
)


def read_npz(
    path: Path | str, *, max_bytes: int = MAX_BYTES
) -> dict[str, Shaped[np.ndarray, " n"]] | Shaped[np.ndarray, "n c"]:
    """Read the cloud of an archive: its columns by name, each of shape (n,), or its rows.

    Raises:
        FileFormatError: If it is damaged, unpacks to too much, or it cannot be told which array is the cloud.
    """
    arrays = read_arrays(path, max_bytes=max_bytes)
    if len(arrays) == 1:
        (only,) = arrays.values()
        if only.dtype.names is not None:
            return {name: np.ascontiguousarray(only.reshape(-1)[name]) for name in only.dtype.names}
        if only.ndim == 2 and only.shape[1] >= 3 and only.dtype.kind in "fiu":
            check_numbers(path, "the array", only.shape[1])
            return only
    tables = [name for name, values in arrays.items() if values.ndim == 2 and values.shape[1] == 3]
    columns = {name: values for name, values in arrays.items() if values.ndim == 1 and values.dtype.names is None}
    check_numbers(path, "the archive", len(columns) + 3)
    if len(columns) + len(tables) == len(arrays) and len(tables) <= 1:
        if tables:
            columns = dict(zip("xyz", arrays[tables[0]].T, strict=True)) | columns
        lower = [name.lower() for name in columns]
        is_cloud = {"x", "y", "z"} <= set(lower) and len(set(lower)) == len(lower)
        taken_twice = bool(tables) and any(name.lower() in "xyz" for name in arrays if arrays[name].ndim == 1)
        if is_cloud and not taken_twice and len({len(values) for values in columns.values()}) == 1:
            return columns
    expected = "one array of rows, or arrays of one length by name, x, y and z among them"
    raise FileFormatError(path, where="the archive", expected=expected, got=_shapes(arrays), fix=_FIX)


def _shapes(arrays: Mapping[str, np.ndarray]) -> str:
    return ", ".join(f"{name} {values.shape}" for name, values in arrays.items())[:160] or "no array"


def read_arrays(path: Path | str, *, max_bytes: int = MAX_BYTES) -> dict[str, Shaped[np.ndarray, "..."]]:
    """All arrays of an archive by name, as one budget allows.

    Raises:
        FileFormatError: If it is damaged, holds anything but numbers, or unpacks to too much.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    most, total = allowed_bytes(len(data), most=max_bytes), 0
    arrays: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if len(members) > _MOST_MEMBERS:
                raise ValueError(f"{len(members)} members")
            for member in members:
                total += member.file_size
                if total > most:
                    expected, actual = f"arrays of at most {most} bytes", f"{total} bytes or more"
                    raise FileFormatError(path, where=member.filename[:80], expected=expected, got=actual)
                with archive.open(member) as handle:
                    content = handle.read(member.file_size + 1)
                name = check_name(path, "the archive", member.filename.removesuffix(".npy"))
                if not name.isprintable() or name in arrays:
                    raise ValueError(f"the name {name!r}"[:80])
                arrays[name] = parse_npy(content, f"{path}, {name}", fields=True)
    except _DAMAGES as error:
        expected = "an archive of NumPy's arrays"
        raise FileFormatError(path, where="the file", expected=expected, got=str(error)[:120]) from error
    return arrays
