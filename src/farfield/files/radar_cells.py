"""Cells of a radar cube in HDF5, one file a frame.

A user block of 512 bytes stands before the HDF5 data: a mark and the SHA-256 of what follows. Nothing is parsed unless
it fits, so a damaged file is known from a whole one before the HDF5 library sees it. A seal is no proof of good will:
the library opens no other file (links, external and virtual storage), and unpacks nothing. A column is one block of
the file, or one chunk that is unpacked here, to the bytes that the column has.
"""

import hashlib
import io
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int16, Int32, UInt16

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes, write_bytes

_MARK = b"Farfield radar cells 1\n"
_BLOCK_BYTES = 512
_MAX_CELLS = 150 * 400 * 250
_MAX_QUANTILES = 1000


def write_radar_cells(
    path: Path | str,
    *,
    index: Int32[np.ndarray, " n"],
    code: UInt16[np.ndarray, " n"],
    quantiles: Int32[np.ndarray, "2 q"],
    doppler: Int16[np.ndarray, " n"] | None = None,
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Write the cells of one frame, all or nothing; the same bytes for the same cells.

    Args:
        path: The file; its folder must exist.
        index: Place of each cell in the flat cube, rising.
        code: Its power, as :class:`farfield.radar.cells.RadarCells` codes it.
        quantiles: Codes of the cube's quantiles.
        doppler: Its mean velocity in 0.1 mm/s.
        attributes: What else is to be remembered, such as the region's name.
    """
    import h5py

    gaps = np.diff(index, prepend=np.int32(0)).astype(np.uint32)
    columns = {"gap": gaps, "code": code, **({} if doppler is None else {"doppler": doppler})}
    handle = io.BytesIO()
    with h5py.File(handle, "w", userblock_size=_BLOCK_BYTES, libver=("v110", "v110"), track_order=False) as file:
        for name, values in columns.items():
            options = {"chunks": (len(values),), "shuffle": True, "compression": "gzip", "compression_opts": 1}
            file.create_dataset(name, data=values, track_times=False, **(options if len(values) else {}))
        file.create_dataset("quantiles", data=quantiles, track_times=False)
        for name, text in sorted((attributes or {}).items()):
            file.attrs[name] = text
    data = handle.getvalue()[_BLOCK_BYTES:]
    block = (_MARK + hashlib.sha256(data).hexdigest().encode() + b"\n").ljust(_BLOCK_BYTES, b"\0")
    write_bytes(path, block + data)


def read_radar_cells(path: Path | str) -> dict[str, np.ndarray]:
    """Read the cells of one frame.

    Returns:
        ``index`` (n,) int32, ``code`` (n,) uint16, ``quantiles`` (2, q) int32 and, where the file has it, ``doppler``
        (n,) int16.

    Raises:
        FileFormatError: If the file is damaged, or not of this kind.
    """
    import h5py

    data = read_bytes(path)
    block, body = data[:_BLOCK_BYTES], data[_BLOCK_BYTES:]
    if not block.startswith(_MARK):
        raise FileFormatError(path, where="byte 0", expected=repr(_MARK.decode()), got=repr(block[:24]))
    stated, digest = block[len(_MARK) : len(_MARK) + 64].decode("ascii", "replace"), hashlib.sha256(body).hexdigest()
    if stated != digest:
        fix = "The file is damaged: convert the frame again."
        raise FileFormatError(path, where="the checksum", expected=stated, got=digest, fix=fix)
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            arrays = {name: _column(file, name) for name in _KINDS if file.id.links.exists(name.encode())}
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, zlib.error) as error:
        expected = "columns gap, code and quantiles as they are written"
        raise FileFormatError(path, where="the HDF5 data", expected=expected, got=str(error)[:120]) from error
    return _checked(path, arrays)


_KINDS = {"gap": ("uint32", 1), "code": ("uint16", 1), "quantiles": ("int32", 2), "doppler": ("int16", 1)}
"""Number type and axes of each column."""
_SHUFFLE, _DEFLATE = 2, 1  # the numbers of HDF5's filters


def _column(file: Any, name: str) -> np.ndarray:
    """One column, of which everything is looked at before anything of it is read."""
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name} is a link to something else")
    column = file[name]
    shape, dtype = getattr(column, "shape", None), getattr(column, "dtype", np.dtype("O"))
    kind, axes = _KINDS[name]
    if shape is None or dtype != kind or len(shape) != axes:
        raise ValueError(f"{name}: expected {kind}, {axes} axes, found {dtype} of shape {shape}")
    if int(np.prod(shape, dtype=np.float64)) > (_MAX_CELLS if axes == 1 else 2 * _MAX_QUANTILES):
        raise ValueError(f"{name}: more numbers than a cube has, shape {shape}")
    properties = column.id.get_create_plist()
    filters = [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]
    layout, size = properties.get_layout(), column.dtype.itemsize * column.size
    if layout in (h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT) and not filters and not properties.get_external_count():
        return np.asarray(column[()])
    is_one_chunk = layout == h5py.h5d.CHUNKED and column.chunks == shape == column.maxshape
    if not is_one_chunk or filters not in ([_SHUFFLE, _DEFLATE], [_DEFLATE]):
        raise ValueError(f"{name} is stored in another way than one block or one packed chunk")
    if column.id.get_storage_size() > size + (size >> 8) + 1024:
        raise ValueError(f"{name}: {column.id.get_storage_size()} packed bytes of {size}")
    skipped, packed = column.id.read_direct_chunk((0,) * axes)
    stream = zlib.decompressobj()
    body = stream.decompress(packed, size + 1)
    if skipped or len(body) != size or not stream.eof:
        raise ValueError(f"{name}: expected a chunk of {size} bytes, found {'more' if len(body) > size else len(body)}")
    planes = np.frombuffer(body, dtype=np.uint8)
    if filters[0] == _SHUFFLE:
        planes = np.ascontiguousarray(planes.reshape(dtype.itemsize, -1).T).reshape(-1)
    return planes.view(dtype).reshape(shape)


def _checked(path: Path | str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    for name, (dtype, axes) in _KINDS.items():
        if name not in arrays and name == "doppler":
            continue
        values = arrays.get(name)
        if values is None or values.dtype != dtype or values.ndim != axes:
            actual = "nothing" if values is None else f"{values.dtype} with {values.ndim} axes"
            raise FileFormatError(path, where=f"column {name!r}", expected=f"{dtype}, {axes} axes", got=actual)
    index = np.cumsum(arrays.pop("gap"), dtype=np.int64)
    lengths = {len(index), *(len(arrays[name]) for name in ("code", "doppler") if name in arrays)}
    if len(lengths) != 1 or len(arrays["quantiles"]) != 2 or (len(index) and index[-1] >= _MAX_CELLS):
        actual = f"lengths {sorted(lengths)}, last cell {index[-1] if len(index) else None}"
        raise FileFormatError(path, where="the columns", expected="one number a cell of the cube", got=actual)
    return {"index": index.astype(np.int32), **arrays}
