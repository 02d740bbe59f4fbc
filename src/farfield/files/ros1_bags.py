"""The records of a ROS 1 bag, ``.bag`` version 2.0: read and held to each other before a message is given.

The format is that of https://wiki.ros.org/Bags/Format/2.0 (CC BY 3.0): records of a header (fields ``name=value``) and
data, both behind their lengths; chunks of messages, packed by bz2 or lz4 or not at all, each with an index of its
messages; behind them all connections and one record a chunk. What a bag claims is compared with what it holds: lengths
with the file, the size of a chunk with what it unpacks to, an index with the chunk's own records (each message once),
connections within a chunk with those behind. ``rosbags`` knows the messages' types and parses them.
"""

import bz2
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Int64

from farfield.errors import FileFormatError
from farfield.files.cuboids import is_name
from farfield.files.limits import FREE_BYTES, MAX_BYTES, MAX_EXPANSION, allowed_bytes, open_file
from farfield.files.remote_paths import as_path

SUFFIX = ".bag"
MARK = b"#ROSBAG V2.0\n"
REINDEX = "rosbag reindex FILE.bag"
"""The command of ROS 1 that writes the index of a bag anew, from its chunks."""

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_MAX_HEADER_BYTES, _MAX_TOPIC = 1 << 20, 1024
_ENTRY_BYTES = 12  # of an index: seconds, nanoseconds, offset
_NS = 1_000_000_000


class Ros1Definition(NamedTuple):
    """A message's definition, as ``rosbags`` has it: its format and its text."""

    format: Any
    data: str


class Ros1Connection(NamedTuple):
    """What one publisher of a topic sends."""

    id: int
    topic: str
    msgtype: str
    msgdef: Ros1Definition
    md5sum: str


class Ros1Topic(NamedTuple):
    """A topic's type and the number of its messages."""

    msgtype: str
    msgcount: int


class _Ros1Record(NamedTuple):
    """A record's header by its fields, and where its data stand."""

    fields: Mapping[str, bytes]
    start: int
    length: int

    def number(self, name: str, size: int) -> int | None:
        """A field that is a whole number of so many bytes; None where there is none."""
        value = self.fields.get(name)
        return None if value is None or len(value) != size else int.from_bytes(value, "little")


class _Ros1Chunk(NamedTuple):
    """Where a chunk's packed bytes stand, how they are packed, and what they unpack to."""

    start: int
    packed: int
    compression: str
    unpacked: int


class Ros1Reader:
    """The connections and messages of a bag; the file stays open until :meth:`close`.

    Args:
        path: The file.

    Raises:
        FileFormatError: If it is no bag of version 2.0, has no index, is cut, or its records contradict each other.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = as_path(path)
        self._file: BinaryIO = open_file(self.path, max_bytes=None)
        self.is_open = True
        self._latest: dict[int, dict[int, tuple[int, int, bytes]]] = {}  # the messages of the chunk unpacked last
        try:
            self._size = self._file.seek(0, 2)
            self._read_index()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let the file go."""
        self.is_open = False
        self._latest = {}
        self._file.close()

    @property
    def topics(self) -> dict[str, Ros1Topic]:
        """Type and number of messages of each topic."""
        counts = np.bincount(self._connection, minlength=len(self.connections)).tolist()
        topics: dict[str, Ros1Topic] = {}
        for connection, count in zip(self.connections, counts, strict=True):
            before = topics.get(connection.topic)
            topics[connection.topic] = Ros1Topic(connection.msgtype, count + (before.msgcount if before else 0))
        return topics

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return len(self._time_ns)

    # The index.

    def _read_index(self) -> None:
        self._file.seek(0)
        mark = self._file.read(len(MARK))
        if mark != MARK:
            old = mark.startswith((b"#ROSBAG V", b"#ROSRECORD", b"#ROSLOG"))
            fix = "`rosbag fix OLD.bag NEW.bag` of ROS 1 brings old bags to version 2.0." if old else "It is no bag."
            got = repr(mark) if mark else "an empty file"
            raise FileFormatError(self.path, where="byte 0", expected=repr(MARK), got=got, fix=fix)
        head = self._record(len(MARK), self._size, _BAG)
        index, *counts = head.number("index_pos", 8), head.number("conn_count", 4), head.number("chunk_count", 4)
        connections, chunks = counts
        if index is None or connections is None or chunks is None:
            raise self._wrong(len(MARK), "index_pos, conn_count and chunk_count in the bag's header", "others")
        if head.fields.get("encryptor"):
            raise self._wrong(len(MARK), "a bag that is not encrypted", repr(head.fields["encryptor"][:40]))
        if index == 0 or (index == self._size and connections + chunks):
            raise FileFormatError(
                self.path,
                where="the bag's header",
                expected="the position of an index",
                got="none: the recorder was stopped before it wrote one",
                fix=f"Write it: {REINDEX}",
            )
        if not head.start + head.length <= index <= self._size:
            raise self._cut(f"an index within the file's {self._size} bytes", f"one at byte {index}")
        if self._size - index > MAX_BYTES:
            raise self._wrong(index, f"an index of at most {MAX_BYTES} bytes", f"{self._size - index}")
        position, limit = index, self._size
        self.connections: list[Ros1Connection] = []
        for _ in range(connections):  # each takes bytes of the index, which end the loop where the number lies
            record = self._record(position, limit, _CONNECTION)
            self.connections.append(self._connection_of(record, self._bytes(record.start, record.length)))
            position = record.start + record.length
        self._check_connections()
        spans: list[tuple[int, int]] = []
        self._chunks: list[_Ros1Chunk] = []
        columns: list[np.ndarray] = []
        for _ in range(chunks):
            record = self._record(position, limit, _CHUNK_INFO)
            position = record.start + record.length
            spans.append(self._read_chunk(record, head.start + head.length, index, columns))
        if position != self._size:
            raise self._wrong(position, "the end of the bag behind its index", f"{self._size - position} bytes more")
        self._check_chunks([(head.start + head.length,) * 2, *sorted(spans), (index, index)])
        rows = np.concatenate(columns) if columns else np.zeros((0, 4), dtype=np.int64)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        self._time_ns, self._connection, self._chunk, self._offset = (np.ascontiguousarray(c) for c in rows.T)

    def _connection_of(self, record: _Ros1Record, data: bytes) -> Ros1Connection:
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys.msg import normalize_msgtype

        fields = self._fields(data, record.start)
        number, topic = record.number("conn", 4), self._text(record.fields, "topic", record.start)
        kind = self._text(fields, "type", record.start)
        text = self._text(fields, "message_definition", record.start)
        if (
            number is None
            or not is_name(topic)
            or len(topic) > _MAX_TOPIC
            or not is_name(kind)
            or len(kind) > _MAX_TOPIC
        ):
            raise self._wrong(
                record.start, "a connection with number, topic and type", f"{topic[:40]!r}, {kind[:40]!r}"
            )
        topic = ("/" if topic.startswith("/") else "") + "/".join(part for part in topic.split("/") if part)
        definition = Ros1Definition(MessageDefinitionFormat.MSG if text.strip() else MessageDefinitionFormat.NONE, text)
        return Ros1Connection(
            number, topic, normalize_msgtype(kind), definition, self._text(fields, "md5sum", record.start)
        )

    def _check_connections(self) -> None:
        """Refuse connections of one number, topics of two types, and types of two definitions."""
        kinds: dict[str, str] = {}
        digests: dict[str, str] = {}
        self._row_of = {connection.id: row for row, connection in enumerate(self.connections)}
        if len(self._row_of) < len(self.connections):
            raise self._contradiction("connections of different numbers", "two of one")
        for connection in self.connections:
            if kinds.setdefault(connection.topic, connection.msgtype) != connection.msgtype:
                both = f"{kinds[connection.topic]} and {connection.msgtype}"
                raise self._contradiction(f"one type of {connection.topic}", both[:200])
            if digests.setdefault(connection.msgtype, connection.md5sum) != connection.md5sum:
                raise self._contradiction(f"one definition of {connection.msgtype}", "two, by their md5sum")

    def _read_chunk(self, info: _Ros1Record, first: int, end: int, columns: list[np.ndarray]) -> tuple[int, int]:
        """Read the index of a chunk that a record names; its first byte and the one behind its index."""
        position, count, version = info.number("chunk_pos", 8), info.number("count", 4), info.number("ver", 4)
        if version != 1 or position is None or count is None or count * 8 != info.length or not first <= position < end:
            raise self._wrong(
                info.start, "a chunk of version 1 before the index, with its numbers of messages", "another"
            )
        pairs = np.frombuffer(self._bytes(info.start, info.length), dtype="<u4").reshape(-1, 2)
        stated = dict(pairs.tolist())
        head = self._record(position, end, _CHUNK)
        size, compression = head.number("size", 4), self._text(head.fields, "compression", position)
        if compression not in ("none", "bz2", "lz4"):
            raise self._wrong(position, "a chunk packed by bz2, lz4 or none", repr(compression[:40]))
        if size is None or size > allowed_bytes(head.length) or head.length > MAX_BYTES:
            expected = f"a chunk of {head.length} bytes that unpacks to at most {allowed_bytes(head.length)}"
            raise self._wrong(position, expected, f"one that claims {size}")
        if compression == "none" and size != head.length:
            raise self._wrong(position, f"a chunk of {head.length} bytes that is not packed", f"one that claims {size}")
        number, after = len(self._chunks), head.start + head.length
        self._chunks.append(_Ros1Chunk(head.start, head.length, compression, size))
        counted: dict[int, int] = {}
        for _ in range(count):
            record = self._record(after, end, _INDEX)
            connection, entries = record.number("conn", 4), record.number("count", 4)
            if record.number("ver", 4) != 1 or entries is None or entries * _ENTRY_BYTES != record.length:
                raise self._wrong(
                    after, f"an index of version 1 of {record.length // _ENTRY_BYTES} messages", f"{entries}"
                )
            if connection not in self._row_of or connection in counted:
                raise self._wrong(after, "an index a connection of the bag", f"another of connection {connection}")
            counted[connection] = entries
            columns.append(self._entries(record, number, self._row_of[connection], size))
            after = record.start + record.length
        if counted != stated:
            raise self._wrong(
                info.start, "as many messages of a chunk as its index has", f"{stated} and {counted}"[:120]
            )
        return position, after

    def _entries(self, record: _Ros1Record, chunk: int, row: int, size: int) -> Int64[np.ndarray, "n 4"]:
        table = np.frombuffer(self._bytes(record.start, record.length), dtype="<u4").reshape(-1, 3).astype(np.int64)
        seconds, fraction, offset = table.T
        if (fraction >= _NS).any() or (offset >= max(size, 1)).any():
            expected = f"nanoseconds below a second and offsets within a chunk of {size} bytes"
            raise self._wrong(record.start, expected, f"up to {fraction.max()} and {offset.max()}")
        full = np.full(len(table), 1, dtype=np.int64)
        return np.column_stack([seconds * _NS + fraction, row * full, chunk * full, offset])

    def _check_chunks(self, spans: Sequence[tuple[int, int]]) -> None:
        """Refuse chunks that overlap or are not in the index, or that unpack to absurdly much together."""
        for (_, end), (start, _) in pairwise(spans):
            if start != end:
                raise self._wrong(end, "a chunk of the index behind the one before", f"the next at byte {start}")
        total, most = sum(chunk.unpacked for chunk in self._chunks), FREE_BYTES + MAX_EXPANSION * self._size
        if total > most:
            raise self._contradiction(f"chunks that unpack to at most {most} bytes", f"{total} bytes")

    # The messages.

    def messages(
        self, connections: Collection[Ros1Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Ros1Connection, int, bytes]]:
        """Connection, time of recording and bytes of each message, by time.

        A chunk is unpacked once as the messages go by in time, and stays in memory until its last one has.

        Args:
            connections: Which.
            start: From this time on, nanoseconds.
            stop: Before this time.

        Raises:
            FileFormatError: If a chunk is damaged, or another than its index says.
        """
        first = 0 if start is None else int(np.searchsorted(self._time_ns, start, side="left"))
        end = len(self._time_ns) if stop is None else int(np.searchsorted(self._time_ns, stop, side="left"))
        is_chosen = np.isin(self._connection[first:end], [self._row_of[connection.id] for connection in connections])
        rows = (first + np.flatnonzero(is_chosen)).tolist()
        last_use = {int(self._chunk[row]): row for row in rows}
        chunks = dict(self._latest)
        for row in rows:
            chunk = int(self._chunk[row])
            if chunk not in chunks:
                chunks = {old: part for old, part in chunks.items() if last_use.get(old, -1) > row}
                total = sum(self._chunks[number].unpacked for number in (*chunks, chunk))
                if total > MAX_BYTES:
                    expected = f"chunks whose times overlap of at most {MAX_BYTES} bytes"
                    raise self._contradiction(expected, f"{total} bytes")
                chunks[chunk] = self._walk(chunk)
                self._latest = {chunk: chunks[chunk]}
            time_ns, number, data = chunks[chunk][int(self._offset[row])]
            yield self.connections[number], time_ns, data

    def _walk(self, number: int) -> dict[int, tuple[int, int, bytes]]:
        """Time, connection and bytes of a chunk's messages by their offset in the index, which names each once."""
        chunk = self._chunks[number]
        where = f"the chunk at byte {chunk.start}"
        packed = self._bytes(chunk.start, chunk.packed)
        data = unpacked_chunk(self.path, where, packed, chunk.compression, chunk.unpacked)
        rows = np.flatnonzero(self._chunk == number)
        stated = dict(zip(self._offset[rows].tolist(), rows.tolist(), strict=True))
        messages: dict[int, tuple[int, int, bytes]] = {}
        position, named = 0, -1  # the index may name the record of the connection that stands before the message
        while position < len(data):
            record = self._record_in(data, position, where)
            content, kind = data[record.start : record.start + record.length], record.number("op", 1)
            is_named = position in stated
            if kind not in (_MESSAGE, _CONNECTION) or (is_named and named >= 0):
                raise self._damaged(where, "messages and connections, each message once in the index", f"kind {kind}")
            named = position if is_named else named
            if kind == _CONNECTION:
                self._check_same(self._connection_of(record, content), where)
            elif named < 0:
                raise self._damaged(where, "every message in the index", f"one at offset {position} that is not")
            else:
                messages[named], named = self._message(record, content, where), -1
            position = record.start + record.length
        for offset, row in stated.items():
            time_ns, connection, _ = messages.get(offset, (-1, -1, b""))
            if (time_ns, connection) != (int(self._time_ns[row]), int(self._connection[row])):
                expected = f"a message at offset {offset} of the time and the connection that the index says"
                raise self._damaged(where, expected, "another or none")
        if len(stated) != len(rows):
            raise self._damaged(where, "each message once in the index", "one twice")
        return messages

    def _message(self, record: _Ros1Record, content: bytes, where: str) -> tuple[int, int, bytes]:
        connection, stamp = record.number("conn", 4), record.fields.get("time", b"")
        if connection not in self._row_of or len(stamp) != 8:
            expected = "a message of one of the bag's connections, with its time"
            raise self._damaged(where, expected, f"connection {connection}")
        seconds, fraction = struct.unpack("<II", stamp)
        return seconds * _NS + fraction, self._row_of[connection], content

    def _check_same(self, connection: Ros1Connection, where: str) -> None:
        row = self._row_of.get(connection.id)
        if row is None or self.connections[row] != connection:
            expected = f"connection {connection.id} as it stands behind the chunks"
            raise self._damaged(where, expected, "another topic, type or definition")

    # Records.

    def _record(self, position: int, limit: int, kind: int) -> _Ros1Record:
        """The record at a position of the file, of one kind, that ends within a limit."""
        head = self._length(position, limit)
        if head > _MAX_HEADER_BYTES:
            raise self._wrong(position, f"a record's header of at most {_MAX_HEADER_BYTES} bytes", f"{head}")
        fields = self._fields(self._bytes(position + 4, head), position)
        length = self._length(position + 4 + head, limit)
        record = _Ros1Record(fields, position + 8 + head, length)
        if record.number("op", 1) != kind:
            raise self._wrong(position, f"a record of kind {kind}", f"one of kind {record.number('op', 1)}")
        return record

    def _length(self, position: int, limit: int) -> int:
        data = self._bytes(position, 4) if position + 4 <= limit else b""
        length = int.from_bytes(data, "little")
        if len(data) < 4 or position + 4 + length > limit:
            raise self._cut(f"a record at byte {position} that ends before byte {limit}", f"{length} bytes")
        return length

    def _record_in(self, data: bytes, position: int, where: str) -> _Ros1Record:
        """The record at a position of an unpacked chunk."""
        head = int.from_bytes(data[position : position + 4], "little")
        start = position + 8 + head
        length = int.from_bytes(data[start - 4 : start], "little")
        if head > _MAX_HEADER_BYTES or start + length > len(data):
            expected = f"records that end within its {len(data)} bytes"
            raise self._damaged(where, expected, f"one of {head} and {length}")
        return _Ros1Record(self._fields(data[position + 4 : position + 4 + head], position), start, length)

    def _fields(self, data: bytes, position: int) -> dict[str, bytes]:
        fields: dict[str, bytes] = {}
        at = 0
        while at < len(data):
            length = int.from_bytes(data[at : at + 4], "little")
            name, mark, value = data[at + 4 : at + 4 + length].partition(b"=")
            text = name.decode("ascii", "replace")
            if not mark or at + 4 + length > len(data) or text in fields:
                raise self._wrong(position, "fields name=value, each once", repr(data[at : at + 40]))
            fields[text] = value
            at += 4 + length
        return fields

    def _text(self, fields: Mapping[str, bytes], name: str, position: int) -> str:
        try:
            return fields[name].decode("utf-8")
        except (KeyError, UnicodeDecodeError) as error:
            raise self._wrong(position, f"a text as {name}", type(error).__name__) from error

    def _bytes(self, position: int, count: int) -> bytes:
        self._file.seek(position)
        data = self._file.read(count)
        if len(data) < count:
            raise self._cut(f"{count} bytes at byte {position}", f"{len(data)}")
        return data

    def _wrong(self, position: int, expected: str, actual: str) -> FileFormatError:
        return FileFormatError(self.path, where=f"byte {position}", expected=expected, got=actual, fix=_FIX)

    def _damaged(self, where: str, expected: str, actual: str) -> FileFormatError:
        return FileFormatError(self.path, where=where, expected=expected, got=actual, fix=_FIX)

    def _contradiction(self, expected: str, actual: str) -> FileFormatError:
        return FileFormatError(self.path, where="the index", expected=expected, got=actual)

    def _cut(self, expected: str, actual: str) -> FileFormatError:
        return FileFormatError(
            self.path, where="the file", expected=expected, got=actual, fix=f"The bag is cut: {_FIX}"
        )


_FIX = f"`{REINDEX}` may save what is left."


def unpacked_chunk(path: Path | str, where: str, data: bytes, compression: str, size: int) -> bytes:
    """Unpack a chunk, never beyond the size that it claims.

    Args:
        path: The file, for messages.
        where: The position in it.
        data: The packed bytes.
        compression: ``none``, ``bz2`` or ``lz4``.
        size: What it claims to unpack to.

    Raises:
        FileFormatError: If it is damaged, or unpacks to another size.
    """
    try:
        if compression == "none":
            chunk = data
        elif compression == "bz2":
            chunk = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
        else:
            from lz4.frame import LZ4FrameDecompressor

            chunk = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    except (OSError, ValueError, RuntimeError, EOFError) as error:
        actual = f"{type(error).__name__}: {error}"[:120]
        raise FileFormatError(
            path, where=where, expected=f"bytes packed by {compression}", got=actual, fix=_FIX
        ) from error
    if len(chunk) != size:
        actual = f"{'more' if len(chunk) > size else len(chunk)}"
        raise FileFormatError(path, where=where, expected=f"{size} bytes when unpacked", got=actual, fix=_FIX)
    return chunk
