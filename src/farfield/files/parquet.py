"""Parquet tables, of which nothing is unpacked before its pages say how large it becomes.

A file is the mark ``PAR1``, column chunks of pages by row group, a footer and its length (Apache Parquet, "File
Format"). Each page begins with a header in Thrift's compact protocol: its size packed and unpacked and the number of
its values. The headers of the chunks that are wanted are added up first; pyarrow reads them then, texts and bytes as
dictionaries, so that one that is repeated takes its memory once.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError, MissingExtraError
from farfield.files.limits import MAX_BYTES, MAX_EXPANSION, open_file
from farfield.files.stand_ins import check_itself

_MARK = b"PAR1"
_FOOTER_BYTES, _HEADER_BYTES, _VALUE_BYTES, _DEPTH = 32 << 20, 1 << 16, 8, 8
_MOST_ROWS = 10_000_000


def read_columns(path: Path, names: Sequence[str], *, optional: Sequence[str] = ()) -> dict[str, Any]:
    """Whole columns of a table, for those that are small.

    Args:
        path: The file.
        names: The columns.
        optional: Columns that are left out where the file lacks them.

    Returns:
        Arrays of pyarrow by name.

    Raises:
        MissingExtraError: If pyarrow is not installed.
        FileFormatError: If the file is damaged, lacks a column, or unpacks to too much.
        OSError: If it cannot be opened.
    """
    with _opened(path) as table:
        columns = _wanted(path, table, names, optional)
        groups = range(len(_read(path, partial(_rows_of_groups, table))))
        if sum(_checked_size(path, group, tuple(columns)) for group in groups) > MAX_BYTES:
            got = f"more in {', '.join(columns)[:120]}"
            raise FileFormatError(path, where="the pages", expected=f"at most {MAX_BYTES} bytes unpacked", got=got)
        batch = _read(path, partial(table.read, columns=columns, use_threads=False))
        return {name: batch.column(name).combine_chunks() for name in columns}


def read_rows(path: Path, names: Sequence[str], rows: Sequence[int]) -> list[dict[str, Any]]:
    """Some rows of a table; of its row groups those that hold them, row by row.

    Args:
        path: The file.
        names: The columns.
        rows: Numbers of the rows, rising.

    Returns:
        A row each: arrays of pyarrow of one value by name.

    Raises:
        MissingExtraError: If pyarrow is not installed.
        FileFormatError: If the file is damaged, lacks a column or a row, or unpacks to too much.
        OSError: If it cannot be opened.
    """
    picked: list[dict[str, Any]] = []
    with _opened(path) as table:
        columns, first = _wanted(path, table, names, ()), 0
        for group, count in enumerate(_read(path, partial(_rows_of_groups, table))):
            inside = [row - first for row in rows if first <= row < first + count]
            if inside:
                _checked_size(path, group, tuple(columns))
                picked += _read(path, partial(_picked, table, group, columns, inside))
            first += count
    if len(picked) != len(rows):
        raise FileFormatError(path, where="the rows", expected=f"{len(rows)} that the keys name", got=f"{len(picked)}")
    return picked


def _picked(table: Any, group: int, names: Sequence[str], rows: Sequence[int]) -> list[dict[str, Any]]:
    picked, chosen = [], set(rows)
    batches = table.iter_batches(batch_size=1, row_groups=[group], columns=list(names), use_threads=False)
    for number, batch in enumerate(batches):
        if batch.num_rows != 1:
            raise ValueError("a batch of more than a row")
        if number in chosen:
            picked.append({name: batch.column(name) for name in names})
        if number >= rows[-1]:
            break
    return picked


def _opened(path: Path) -> Any:
    """The table of a file whose footer is of a sensible size."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("pyarrow", "argoverse2", "Reading Parquet files") from error
    check_itself(path)
    with open_file(path, max_bytes=None) as handle:
        size = os.fstat(handle.fileno()).st_size
        head = handle.read(4)
        handle.seek(max(size - 8, 0))
        tail = handle.read(8)
    length = int.from_bytes(tail[:4], "little")
    if size < 12 or head != _MARK or tail[4:] != _MARK:
        raise FileFormatError(path, where="the ends", expected=f"the mark {_MARK!r}", got=f"{head!r} and {tail[4:]!r}")
    if length > min(size - 12, _FOOTER_BYTES):
        raise FileFormatError(path, where="the footer", expected="one within the file", got=f"{length} bytes")

    return _read(path, partial(_with_dictionaries, path))


def _with_dictionaries(path: Path) -> Any:
    """The table, its texts and bytes read as dictionaries."""
    import pyarrow.parquet

    limits = {"thrift_string_size_limit": _FOOTER_BYTES, "thrift_container_size_limit": 1_000_000}
    open_table = partial(pyarrow.parquet.ParquetFile, path, pre_buffer=False, buffer_size=1 << 20, **limits)
    table = open_table()
    if table.metadata.num_rows > _MOST_ROWS:
        got = f"{table.metadata.num_rows}"
        raise FileFormatError(path, where="the footer", expected=f"at most {_MOST_ROWS} rows", got=got)
    kinds = (pyarrow.types.is_string, pyarrow.types.is_large_string, pyarrow.types.is_binary)
    texts = [field.name for field in table.schema_arrow if any(kind(field.type) for kind in kinds)]
    if not texts:
        return table
    table.close()
    return open_table(read_dictionary=texts)


def _wanted(path: Path, table: Any, names: Sequence[str], optional: Sequence[str]) -> list[str]:
    held = table.schema_arrow.names
    odd = [name for name in names if held.count(name) != 1] + [name for name in optional if held.count(name) > 1]
    if odd:
        expected, got = f"the column {odd[0]} once", f"columns {', '.join(held)[:200]}"
        raise FileFormatError(path, where="the footer", expected=expected, got=got)
    return [*names, *(name for name in optional if name in held)]


def _read(path: Path, action: Any) -> Any:
    """What pyarrow reads, its complaints in our words."""
    import pyarrow

    try:
        return action()
    except (pyarrow.ArrowException, OSError, ValueError, IndexError, KeyError, TypeError, MemoryError) as error:
        raise FileFormatError(path, where="the file", expected="a Parquet table", got=str(error)[:200]) from error


def _checked_size(path: Path, group: int, names: tuple[str, ...]) -> int:
    """Bytes that columns of a row group unpack to, refused where they are too many for what is packed."""
    status = path.stat()
    return _size_of(path, group, names, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=256)
def _size_of(path: Path, group: int, names: tuple[str, ...], modified_ns: int, size: int) -> int:
    del modified_ns
    total = 0
    with _opened(path) as table, open_file(path, max_bytes=None) as handle:
        for name, start, packed in _read(path, partial(_chunks, table, group, names)):
            where = f"column {name[:80]}, row group {group}"
            if not 4 <= start <= start + packed <= size:
                raise FileFormatError(path, where=where, expected="pages within the file", got=f"{start} + {packed}")
            unpacked = 0
            for page in _pages(path, handle, start, start + packed, where):
                if page > MAX_BYTES:
                    raise FileFormatError(path, where=where, expected=f"pages of {MAX_BYTES} bytes", got=f"{page}")
                unpacked += page
            if unpacked > MAX_BYTES + MAX_EXPANSION * packed:
                expected = f"at most {MAX_EXPANSION} times its {packed} bytes unpacked"
                raise FileFormatError(path, where=where, expected=expected, got=f"{unpacked} bytes")
            total += unpacked
    return total


def _chunks(table: Any, group: int, names: Sequence[str]) -> list[tuple[str, int, int]]:
    """Name, start and packed size of the chunks of columns; of lists the name goes on behind the column's."""
    row_group, chunks = table.metadata.row_group(group), []
    for number in range(row_group.num_columns):
        leaf = table.schema.column(number).path
        if any(leaf == name or leaf.startswith(f"{name}.") for name in names):
            chunk = row_group.column(number)
            start = min(chunk.data_page_offset, chunk.dictionary_page_offset or chunk.data_page_offset)
            chunks.append((leaf, start, chunk.total_compressed_size))
    return chunks


def _rows_of_groups(table: Any) -> list[int]:
    return [table.metadata.row_group(group).num_rows for group in range(table.metadata.num_row_groups)]


def _pages(path: Path, handle: Any, start: int, end: int, where: str) -> Iterator[int]:
    """Bytes of each page in memory: its own and those of its values."""
    at = start
    while at < end:
        handle.seek(at)
        head = handle.read(min(_HEADER_BYTES, end - at))
        try:
            fields, length = _struct(head, 0, 0)
            unpacked, packed = (int(fields[number]) for number in (2, 3))
            data: Any = next((fields[number] for number in (5, 8, 7) if number in fields), {})
            count = int(data.get(1, 0)) if isinstance(data, Mapping) else -1
        except (IndexError, KeyError, ValueError, TypeError) as error:
            raise FileFormatError(path, where=where, expected="a page's header", got=f"others at {at}") from error
        if min(unpacked, packed, count) < 0 or at + length + packed > end:
            raise FileFormatError(path, where=where, expected="a page within its chunk", got=f"others at {at}")
        yield unpacked + count * _VALUE_BYTES
        at += length + packed


# Thrift's compact protocol: a field is a byte of its number's step and its type, then the value.


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number of more than 70 bits")


def _signed(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at


def _struct(data: bytes, at: int, depth: int) -> tuple[dict[int, Any], int]:
    """The fields of a structure by number, and where it ends."""
    if depth > _DEPTH:
        raise ValueError("structures nested too deep")
    fields: dict[int, Any] = {}
    number = 0
    while data[at]:
        step, kind = data[at] >> 4, data[at] & 0x0F
        at += 1
        if step:
            number += step
        else:
            number, at = _signed(data, at)
        fields[number], at = _value(data, at, kind, depth)
    return fields, at + 1


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    if kind in (1, 2):  # a flag, whose value is its type
        return kind == 1, at
    if kind == 3:
        return data[at], at + 1
    if kind in (4, 5, 6):
        return _signed(data, at)
    if kind == 7:
        return None, at + 8
    if kind == 8:
        length, at = _varint(data, at)
        if length > len(data) - at:
            raise ValueError("a text beyond the header")
        return None, at + length
    if kind in (9, 10):
        count, entry = data[at] >> 4, data[at] & 0x0F
        at += 1
        if count == 15:
            count, at = _varint(data, at)
        if count > len(data) - at:
            raise ValueError("a list beyond the header")
        if depth > _DEPTH:
            raise ValueError("lists nested too deep")
        for _ in range(count):
            _, at = (None, at + 1) if entry in (1, 2) else _value(data, at, entry, depth + 1)
        return None, at
    if kind == 12:
        return _struct(data, at, depth + 1)
    raise ValueError(f"a field of type {kind}")
