"""Feather tables (Arrow's IPC files, version 2), of which nothing is unpacked before its size is known.

A file is the mark ``ARROW1``, two zeros, messages, and a footer that names their places once more. A message is a
continuation (0xFFFFFFFF), the length of its metadata, the metadata (a flatbuffer) and a body of buffers; a packed one
begins with the size that it unpacks to (Apache Arrow, "Columnar Format: Serialization and IPC"). The messages are read
one after another, as a stream: the footer, which may lead anywhere, is not looked at.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import FileFormatError, MissingExtraError
from farfield.files.atomic import read_bytes
from farfield.files.limits import MAX_BYTES

_MARK, _END = b"ARROW1\0\0", b"ARROW1"
_ROW_BYTES = 8  # of a column in memory: a number of eight bytes, or the place of a text


def feather_names(path: Path) -> tuple[str, ...]:
    """Names of a file's columns; arguments and errors are those of :func:`read_feather`."""
    pyarrow, messages = _opened(path)
    try:
        with pyarrow.ipc.open_stream(messages) as stream:
            return tuple(stream.schema.names)
    except (pyarrow.ArrowException, OSError, ValueError, IndexError) as error:
        raise FileFormatError(path, where="the file", expected="a feather table", got=str(error)[:200]) from error


def _opened(path: Path) -> tuple[Any, Any]:
    """Pyarrow, and the messages of a file."""
    try:
        import pyarrow
        import pyarrow.ipc
    except ImportError as error:
        raise MissingExtraError("pyarrow", "argoverse2", "Reading Argoverse 2") from error
    data = read_bytes(path)
    if not data.startswith(_MARK):
        raise FileFormatError(path, where="byte 0", expected="a feather table (version 2)", got=repr(data[:8]))
    if not data.endswith(_END):  # what is cut loses its last rows
        raise FileFormatError(path, where="the end", expected=f"the mark {_END!r}", got=repr(data[-8:]))
    return pyarrow, pyarrow.py_buffer(data)[len(_MARK) :]


def read_feather(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Read columns of a feather file: numbers and texts.

    Args:
        path: The file.
        names: The columns.

    Raises:
        MissingExtraError: If pyarrow is not installed.
        FileFormatError: If the file is damaged, lacks a column, holds anything else in one, or unpacks to too much.
    """
    pyarrow, messages = _opened(path)
    try:
        _check_sizes(path, pyarrow.ipc.MessageReader.open_stream(messages))
        with pyarrow.ipc.open_stream(messages) as stream:
            schema = stream.schema
            if any(schema.names.count(name) != 1 for name in names):
                actual = f"columns {', '.join(schema.names)[:200]}"
                raise FileFormatError(path, where="the header", expected=f"each of {', '.join(names)} once", got=actual)
            strange = [name for name in names if not _is_plain(pyarrow.types, schema.field(name).type)]
            if strange:
                where, actual = f"column {strange[0]}", str(schema.field(strange[0]).type)[:200]
                raise FileFormatError(path, where=where, expected="numbers or texts", got=actual)
            table = stream.read_all().select(list(names))
        table.validate(full=True)
        holed = [name for name in names if table.column(name).null_count]
        if holed:
            raise FileFormatError(path, where="the table", expected="no nulls", got=f"some in {', '.join(holed)}")
        return {name: table.column(name).to_numpy() for name in names}
    except (pyarrow.ArrowException, OSError, ValueError, IndexError) as error:
        raise FileFormatError(path, where="the file", expected="a feather table", got=str(error)[:200]) from error


def _is_plain(types: Any, kind: Any) -> bool:
    inner = kind.value_type if types.is_dictionary(kind) else kind
    is_text = types.is_string(inner) or types.is_large_string(inner)
    return bool(is_text or types.is_integer(inner) or types.is_floating(inner) or types.is_boolean(inner))


def _check_sizes(path: Path, messages: Any) -> None:
    """Add up what all buffers unpack to, and the rows."""
    total = 0
    for number, message in enumerate(_messages(messages)):
        if message.type not in ("record batch", "dictionary"):
            continue
        metadata, body = message.metadata.to_pybytes(), message.body
        batch = _field(metadata, int.from_bytes(metadata[:4], "little"), 2)
        if message.type == "dictionary":
            batch = None if batch is None else _field(metadata, batch, 1)
        if batch is None:
            raise ValueError(f"message {number} without rows")
        total += _rows(metadata, batch)
        for offset, length in _buffers(metadata, batch):
            if not 0 <= offset <= offset + length <= len(body):
                raise ValueError(f"message {number}: a buffer beyond its body")
            packed = _field(metadata, batch, 3) is not None and length >= 8
            size = int.from_bytes(body[offset : offset + 8].to_pybytes(), "little", signed=True) if packed else length
            total += length if size < 0 else size
        if total > MAX_BYTES:
            expected = f"a table of at most {MAX_BYTES} bytes when unpacked"
            raise FileFormatError(path, where=f"message {number}", expected=expected, got=f"{total} bytes or more")


def _messages(reader: Any) -> Iterator[Any]:
    while True:
        try:
            message = reader.read_next_message()
        except StopIteration:
            return
        if message is None:
            return
        yield message


# What of a flatbuffer is needed: a table is the distance back to the list of its fields' places, then the fields.


def _place(data: bytes, table: int, number: int) -> int | None:
    """Where a field of a table stands; None where it has none."""
    fields = table - int.from_bytes(data[table : table + 4], "little", signed=True)
    if not 0 <= fields < len(data) - 4 or not 0 <= table < len(data) - 4:
        raise ValueError("damaged metadata")
    entry = 4 + 2 * number
    if entry + 2 > int.from_bytes(data[fields : fields + 2], "little"):
        return None
    offset = int.from_bytes(data[fields + entry : fields + entry + 2], "little")
    return table + offset if offset else None


def _field(data: bytes, table: int, number: int) -> int | None:
    """Where what a field refers to stands: a table or a list; None where there is none."""
    at = _place(data, table, number)
    return None if at is None else at + int.from_bytes(data[at : at + 4], "little")


def _rows(data: bytes, batch: int) -> int:
    """Bytes of the rows of a batch in all its columns, once they are arrays of NumPy."""
    at, nodes = _place(data, batch, 0), _field(data, batch, 1)
    length = 0 if at is None else int.from_bytes(data[at : at + 8], "little", signed=True)
    columns = 0 if nodes is None else int.from_bytes(data[nodes : nodes + 4], "little")
    if length < 0:
        raise ValueError(f"{length} rows")
    return length * _ROW_BYTES * max(columns, 1)


def _buffers(data: bytes, batch: int) -> Iterator[tuple[int, int]]:
    """Offset and length of each buffer in the body."""
    start = _field(data, batch, 2)
    count = 0 if start is None else int.from_bytes(data[start : start + 4], "little")
    if start is None or start + 4 + 16 * count > len(data):
        raise ValueError("damaged metadata")
    for at in range(start + 4, start + 4 + 16 * count, 16):
        yield (
            int.from_bytes(data[at : at + 8], "little", signed=True),
            int.from_bytes(data[at + 8 : at + 16], "little", signed=True),
        )
