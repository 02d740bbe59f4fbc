"""What a bag's file is held to before it is opened: whole, of ROS 2, and of a size that it claims with reason.

Sizes that records claim are checked before anything is unpacked; tables before anything is asked of them.
"""

import itertools
import re
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import unquote

from farfield.errors import FileFormatError, MissingExtraError, plain
from farfield.files.limits import FREE_BYTES, MAX_BYTES, MAX_EXPANSION, allowed_bytes, open_file

SUFFIXES = (".mcap", ".db3")
"""Endings of the names of a bag's files, before ``.zstd`` where a file is packed as a whole."""


def check_storage(path: Path) -> None:
    """Refuse a file of messages that is no whole MCAP or SQLite file, or that claims absurdly much.

    Args:
        path: The file; one of another suffix is none of messages.

    Raises:
        FileFormatError: If it is so.
    """
    if path.suffix.lower() == ".db3":
        if unquote(str(path)) != str(path) or {"?", "#"} & set(str(path)):  # rosbags would open another one
            raise FileFormatError(path, where="the path", expected="none with %, ? or # in it", got=path.name[:80])
        _check_size(path)
        check_tables(path)
    elif path.suffix.lower() == ".mcap":
        check_records(path)
        check_kind(path)


def _check_size(path: Path) -> None:
    """Refuse an SQLite file that is shorter than its header says (SQLite's file format, 1.3.8)."""
    with open_file(path, max_bytes=None) as handle:
        head = handle.read(100)
    size = path.stat().st_size
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    claimed_bytes = page * int.from_bytes(head[28:32], "big")
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0") or size < claimed_bytes:
        raise FileFormatError(
            path, where="the file", expected=f"an SQLite file of {claimed_bytes} bytes", got=f"{size} bytes"
        )


def check_tables(path: Path) -> None:
    """Refuse an SQLite file that is more than a bag's plain tables, or whose messages hold more than the file.

    A view or a virtual table may compute rows without end, and pages that lead to one another messages without end.

    Raises:
        FileFormatError: If it is one of these, or no whole SQLite file.
    """
    size = path.stat().st_size
    calls = itertools.count()
    most_calls = (_FREE_STEPS + size) // _STEPS_A_CALL
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1&mode=ro", uri=True)) as database:
            database.set_progress_handler(lambda: next(calls) > most_calls, _STEPS_A_CALL)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_CELL_BYTES)
            _check_schema(path, database, size)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_BYTES)
            longest, total = database.execute(
                "SELECT max(bytes), total(bytes) FROM "
                "(SELECT CASE typeof(data) WHEN 'blob' THEN length(data) ELSE 1e18 END AS bytes FROM messages)"
            ).fetchone()
    except (sqlite3.Error, OverflowError, ValueError) as error:
        actual = "rows without end" if "interrupted" in str(error) else plain(error)[:200]
        raise FileFormatError(path, where="the tables", expected="those of a bag", got=actual) from error
    if (longest or 0) > min(size, MAX_BYTES) or total > size:
        expected = f"messages within the file's {size} bytes, each of at most {MAX_BYTES}"
        raise FileFormatError(path, where="the messages", expected=expected, got=f"{total:.0f}, one of {longest:.0f}")


def _check_schema(path: Path, database: sqlite3.Connection, size: int) -> None:
    """Refuse whatever the list of a file's objects defines that is no table and no index.

    Its other columns may say anything: SQLite goes by the definitions. It writes them in this form itself, without
    comments, however they were typed. Tables are looked at by the names that are read, in any case of letters.
    """
    rows = database.execute(f"SELECT type, name, sql FROM sqlite_master LIMIT {_MAX_OBJECTS + 1}").fetchall()  # noqa: S608 - a number
    if len(rows) > _MAX_OBJECTS:
        expected = f"at most {_MAX_OBJECTS} tables and indexes"
        raise FileFormatError(path, where="the schema", expected=expected, got="more")
    for kind, name, text in rows:
        if not (text is None and kind == "index") and not _PLAIN_DEFINITION.match(str(text)):
            actual = f"{kind} {name!r}, {' '.join(str(text).split()[:3])}"[:80]
            raise FileFormatError(path, where="the schema", expected="tables and indexes alone", got=actual)
    for name in _TABLES:
        columns = database.execute(f"PRAGMA table_xinfo({name})").fetchall()
        if any(column[6] for column in columns):
            actual = f"computed ones in {name!r}"
            raise FileFormatError(path, where="the schema", expected="plain columns", got=actual)
        if columns and name != "messages":
            cells = database.execute(f"SELECT * FROM {name} LIMIT {_MAX_ROWS + 1}")  # noqa: S608 - names of ours
            lengths = [sum(len(cell) for cell in row if isinstance(cell, str | bytes)) for row in cells]
            if len(lengths) > _MAX_ROWS or sum(lengths) > size:
                expected, actual = f"at most {_MAX_ROWS} rows within the file", f"{len(lengths)} in {name!r}"
                raise FileFormatError(path, where="the tables", expected=expected, got=actual)


_TABLES = ("messages", "topics", "message_definitions", "schema")  # that rosbags reads
_PLAIN_DEFINITION = re.compile(r"CREATE (TABLE|INDEX|UNIQUE INDEX) ")
_MAX_OBJECTS = 1000
_STEPS_A_CALL, _FREE_STEPS = 10_000, 10_000_000  # of SQLite's machine; a row of a bag takes some ten, and as many bytes
_MAX_CELL_BYTES, _MAX_ROWS = 1 << 20, 10_000


# A record is an opcode, its length (8 bytes) and its content; a chunk (opcode 6) holds two times, the size that it
# unpacks to, a checksum, the name of the compression, and the packed bytes behind their length (https://mcap.dev/spec).
# A chunk of a few kilobytes of zstd may unpack to terabytes, whatever size it claims.

_MAGIC, _CHUNK, _CHUNK_INDEX, _HEAD, _FOOTER_BYTES = b"\x89MCAP0\r\n", 6, 8, 36, 37


class _Chunk(NamedTuple):
    """What a chunk, or an index of it, says: sizes, and in an index the times of its messages."""

    packed: int
    unpacked: int


def check_records(path: Path) -> None:
    """Walk through a file's records without reading their content; a file that is no MCAP is left to its reader.

    Raises:
        FileFormatError: If a record claims to end beyond the file, or a chunk to unpack to absurdly much.
    """
    size, number = path.stat().st_size, 0
    chunks: dict[int, _Chunk] = {}
    spans: list[tuple[int, int, int]] = []
    with open_file(path, max_bytes=None) as handle:
        if handle.read(len(_MAGIC)) != _MAGIC:
            return
        handle.seek(max(size - _FOOTER_BYTES, 0))
        summary = int.from_bytes(handle.read(_FOOTER_BYTES)[9:17], "little")
        handle.seek(len(_MAGIC))
        is_record = summary == 0
        while (start := handle.tell()) < size - len(_MAGIC):
            head = handle.read(9)
            length, offset = int.from_bytes(head[1:], "little"), handle.tell()
            if len(head) < 9 or offset + length > size:
                raise _too_large(path, number, f"a record that ends within the file's {size} bytes", f"{length} bytes")
            is_record = is_record or start == summary
            if head[0] == _CHUNK:
                chunks[start] = _check_chunk(path, number, handle.read(min(length, _HEAD + 64)), length)
            elif head[0] == _CHUNK_INDEX:
                spans.append(_check_index(path, number, handle.read(min(length, _MAX_INDEX_BYTES)), chunks))
            handle.seek(offset + length)
            number += 1
    if not is_record:
        raise FileFormatError(path, where="the footer", expected="a summary that begins at a record", got=f"{summary}")
    _check_together(path, size, chunks, spans)


_MAX_INDEX_BYTES = 1 << 20


def _check_index(path: Path, number: int, data: bytes, chunks: dict[int, _Chunk]) -> tuple[int, int, int]:
    """First and last time of a chunk, and how much it grows by; each chunk has one index, which says what it says."""
    first_ns, last_ns, start = (int.from_bytes(data[at : at + 8], "little") for at in (0, 8, 16))
    at = 36 + int.from_bytes(data[32:36], "little")  # behind the offsets by channel
    at += 8
    at += 4 + int.from_bytes(data[at : at + 4], "little")
    stated = _Chunk(int.from_bytes(data[at : at + 8], "little"), int.from_bytes(data[at + 8 : at + 16], "little"))
    chunk = chunks.pop(start, None)
    if chunk is None or chunk != stated or len(data) < at + 16:
        expected = "an index of a chunk before it, of its sizes, and the only one"
        raise _too_large(path, number, expected, f"one of {stated.packed} and {stated.unpacked} bytes at {start}")
    chunks[-1 - start] = chunk  # counted once; another index of it finds nothing
    return first_ns, last_ns, max(chunk.unpacked - allowed_at_once(chunk.packed), 0)


def _check_together(path: Path, size: int, chunks: Mapping[int, _Chunk], spans: Sequence[tuple[int, int, int]]) -> None:
    """Refuse chunks that together unpack to absurdly much: in all, or at once, as the times of several overlap."""
    total, most = sum(chunk.unpacked for chunk in chunks.values()), FREE_BYTES + MAX_EXPANSION * size
    if total > most:
        raise FileFormatError(
            path, where="the chunks", expected=f"at most {most} bytes when unpacked", got=f"{total} bytes"
        )
    steps = sorted([(first, 0, grown) for first, _, grown in spans] + [(last, 1, -grown) for _, last, grown in spans])
    at_once = max(itertools.accumulate(grown for *_, grown in steps), default=0)
    if at_once > FREE_BYTES:
        expected = f"chunks whose times overlap of at most {FREE_BYTES} bytes more than a few times their size"
        raise FileFormatError(path, where="the chunks", expected=expected, got=f"{at_once} bytes")


def allowed_at_once(packed: int) -> int:
    """What chunks of so many bytes unpack to in ordinary bags."""
    return 8 * packed


# Bags that are whole, but of another system: ROS 1, or messages in another encoding than ROS 2's (CDR).

_HEADER, _CHANNEL, _ROS1_BAG = 1, 4, b"#ROSBAG V"
TO_ROS2 = "rosbags-convert --src FILE.bag --dst FOLDER"
"""The command that turns a ROS 1 bag into a ROS 2 one; it comes with rosbags, which reads bags here."""


def check_kind(path: Path) -> None:
    """Refuse a file that is no MCAP, or an MCAP of ROS 1 or of messages that are not in ROS 2's encoding.

    Raises:
        FileFormatError: If it is one of these; the message names the converter.
    """
    encodings: set[str] = set()
    with open_file(path, max_bytes=None) as handle:
        magic = handle.read(len(_MAGIC))
        if magic != _MAGIC:
            if (magic + handle.read(8)).startswith(_ROS1_BAG):
                raise ros1_error(path)
            actual = "an empty file" if not magic else repr(magic)
            raise FileFormatError(path, where="byte 0", expected="MCAP's mark", got=actual, fix="It is no MCAP file.")
        while len(head := handle.read(9)) == 9:
            length, offset = int.from_bytes(head[1:], "little"), handle.tell()
            if head[0] in (_HEADER, _CHANNEL):
                content = handle.read(min(length, 4096))
                texts = _texts(content[4:] if head[0] == _CHANNEL else content)
                encodings |= set(texts[:1] if head[0] == _HEADER else texts[1:2])
            handle.seek(offset + length)
    if "ros1" in encodings:
        raise ros1_error(path)
    others = sorted(encodings & {"protobuf", "json", "flatbuffer", "cbor", "msgpack"})
    if others and "cdr" not in encodings:
        raise FileFormatError(
            path,
            where="the channels",
            expected="messages of ROS 2 (encoding cdr)",
            got=f"messages in {', '.join(others)}",
            fix="Write the clouds as sensor_msgs/msg/PointCloud2 into a ROS 2 bag, or as .pcd files into a folder.",
        )


def ros1_error(path: Path) -> FileFormatError:
    """The error of a ROS 1 bag, whatever its suffix."""
    fix = f"Convert the bag: {TO_ROS2} (pip install rosbags); of an MCAP of ROS 1 the .bag that it was made from."
    return FileFormatError(path, where="the file", expected="a ROS 2 bag", got="a bag of ROS 1", fix=fix)


def _texts(content: bytes) -> list[str]:
    """The texts at the beginning of a record, each behind its length."""
    texts: list[str] = []
    while len(content) >= 4 and len(texts) < 2:
        length = int.from_bytes(content[:4], "little")
        texts.append(content[4 : 4 + length].decode("utf-8", "replace"))
        content = content[4 + length :]
    return texts


def _check_chunk(path: Path, number: int, head: bytes, length: int) -> _Chunk:
    unpacked, name = int.from_bytes(head[16:24], "little"), int.from_bytes(head[28:32], "little")
    packed = int.from_bytes(head[32 + name : 40 + name], "little")
    if len(head) < 40 + name or packed > length:
        raise _too_large(path, number, f"a chunk within its record of {length} bytes", f"{packed} packed bytes")
    if unpacked > allowed_bytes(packed):
        expected = f"a chunk of {packed} bytes that unpacks to at most {allowed_bytes(packed)}"
        raise _too_large(path, number, expected, f"one that claims {unpacked}")
    return _Chunk(packed, unpacked)


def _too_large(path: Path, number: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"record {number}", expected=expected, got=actual)


@contextmanager
def bounded() -> Iterator[None]:
    """Make rosbags unpack a chunk to no more than the size that it claims, which is refused where it is absurd.

    Nor does it read, in the block, the settings of transport: YAML without bounds in each topic, which nothing here
    needs. Bags that others open meanwhile, in other threads too, keep theirs.
    """
    from rosbags.rosbag2 import reader, storage_mcap, storage_sqlite3

    for module in (reader, storage_mcap, storage_sqlite3):
        parse = vars(module)["parse_qos"]
        if not isinstance(parse, partial):
            vars(module)["parse_qos"] = partial(_transport, parse)
    decompressors: dict[str, Any] = storage_mcap.DECOMPRESSORS
    for name in ("zstd", "lz4"):
        if name in decompressors and not isinstance(decompressors[name], partial):
            decompressors[name] = partial(unpacked, name)
    token = _opens_here.set(True)
    try:
        yield
    finally:
        _opens_here.reset(token)


_opens_here: ContextVar[bool] = ContextVar("opens_here", default=False)
"""Whether a bag is being opened by this module's user."""


def _transport(parse: Callable[[Any], list[Any]], settings: Any) -> list[Any]:
    return [] if _opens_here.get() else parse(settings)


def unpacked(name: str, data: bytes, size: int) -> bytes:
    """Unpack one chunk, never beyond its size.

    Args:
        name: "zstd" or "lz4".
        data: The packed bytes.
        size: What the chunk claims to unpack to.

    Raises:
        ValueError: If the size is absurd, or the bytes unpack to more.
    """
    if size > allowed_bytes(len(data)):
        raise ValueError(f"a chunk of {len(data)} bytes that claims to unpack to {size}")
    if name == "zstd":
        from rosbags.rosbag2.storage_mcap import zstd

        chunk: bytes = zstd.ZstdDecompressor().decompress(data, max_length=size + 1)
    else:
        from lz4.frame import LZ4FrameDecompressor

        chunk = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(chunk) > size:
        raise ValueError(f"a chunk that unpacks to more than the {size} bytes that it claims")
    return chunk


def unpacked_message(data: bytes) -> bytes:
    """Unpack a message that was packed by itself (``compression_mode: message``).

    Raises:
        ValueError: If it unpacks to absurdly much.
    """
    from rosbags.rosbag2.storage_mcap import zstd

    most = allowed_bytes(len(data))
    message: bytes = zstd.ZstdDecompressor().decompress(data, max_length=most + 1)
    if len(message) > most:
        raise ValueError(f"a message of {len(data)} bytes that unpacks to more than {most}")
    return message


def check_packed_file(path: Path) -> None:
    """Check a file that was packed as a whole (``compression_mode: file``): what it unpacks to, up to a bound.

    Raises:
        FileFormatError: If it unpacks to more than :data:`MAX_EXPANSION` times its size and :data:`FREE_BYTES`, or to
            what :func:`check_storage` refuses.
    """
    try:
        from rosbags.rosbag2.storage_mcap import zstd
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "Reading ROS 2 bags") from error
    size, unpacked_bytes = path.stat().st_size, 0
    most = FREE_BYTES + MAX_EXPANSION * size
    try:
        with TemporaryDirectory() as folder, zstd.open(path, "rb") as handle:
            storage = Path(folder, path.stem)
            if storage.suffix.lower() not in SUFFIXES:  # it would be opened without a check
                expected = " or ".join(f"one that ends with {suffix}.zstd" for suffix in SUFFIXES)
                raise FileFormatError(path, where="the name", expected=expected, got=path.name[:80])
            with storage.open("wb") as copy:
                while block := handle.read(1 << 20):
                    unpacked_bytes += len(block)
                    if unpacked_bytes > most:
                        raise FileFormatError(
                            path, where="the file", expected=f"at most {most} bytes when unpacked", got="more"
                        )
                    copy.write(block)
            try:
                check_storage(storage)
            except FileFormatError as error:
                where, expected, got = f"unpacked, {error.where}", error.expected, error.got
                raise FileFormatError(path, where=where, expected=expected, got=got, fix=error.fix) from error
    except (OSError, EOFError, zstd.ZstdError) as error:
        raise FileFormatError(path, where="the file", expected="a file packed with zstd", got=str(error)) from error
