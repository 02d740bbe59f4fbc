"""ROS 2 bags: folders with ``metadata.yaml``, or a lone ``.mcap`` or ``.db3`` file, read through ``rosbags``.

Whatever a damaged bag makes of the library becomes a :class:`FileFormatError`, and a bag that gives fewer messages than
it says is damaged. A changed payload is seen only where the format has a checksum (MCAP's chunks, if the writer filled
it in); SQLite has none, and an altered message without a checksum reads as another message. What would unpack to
absurdly much is refused before it is (:mod:`farfield.files.bags`).
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np
from jaxtyping import Int64

from farfield.errors import FarfieldError, FileFormatError, MissingExtraError
from farfield.files.stand_ins import check_itself
from farfield.files.suffixes import any_case

SUFFIXES = (".mcap", ".db3")
HEADER = "std_msgs/msg/Header"
_MAX_MESSAGE_BYTES = 1 << 30


class Topic(NamedTuple):
    """One topic of a bag: its name, the type of its messages, and how many the bag says that there are."""

    name: str
    kind: str
    size: int


@dataclass(frozen=True, eq=False)
class Stamps:
    """When a topic's messages were recorded and, by their headers, taken; in the bag's order, shape (n,) each."""

    log_ns: Int64[np.ndarray, " n"]
    header_ns: Int64[np.ndarray, " n"] | None


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file of a known suffix, or a folder with a bag's metadata."""
    if path.is_file():
        return path.suffix.lower() in SUFFIXES
    return (path / "metadata.yaml").is_file() and any(
        next(path.glob(f"*{any_case(suffix)}"), None) for suffix in SUFFIXES
    )


class Bag:
    """A bag that is open while it is used; it pickles closed.

    Args:
        path: The folder or the file.

    Raises:
        MissingExtraError: If rosbags is not installed.
        FileFormatError: If the bag is damaged or cut.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._open: Any = None
        self._packed = False
        for part in [self.path] if self.path.is_file() else sorted(self.path.iterdir()):
            if part.suffix.lower() in (*SUFFIXES, ".yaml"):
                check_itself(part)
            if part.suffix.lower() == ".db3":
                _check_size(part)
            elif part.suffix.lower() == ".mcap":
                check_records(part)
                check_kind(part)
            elif part.suffix == ".zstd":
                check_packed_file(part)
        with guarded(self.path, "the bag"):
            reader = self._reader()
            self.topics = tuple(
                Topic(str(name), str(topic.msgtype), int(topic.msgcount))
                for name, topic in sorted(reader.topics.items())
            )
            claimed_count = int(reader.message_count)
        if (counted := sum(topic.size for topic in self.topics)) != claimed_count:
            raise _wrong(self.path, counted, f"{claimed_count} messages in all topics", f"{counted}")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": None}

    def _reader(self) -> Any:
        if self._open is None:
            try:
                from rosbags.rosbag2 import Reader
            except ImportError as error:
                raise MissingExtraError("rosbags", "bags", "Reading ROS 2 bags") from error
            bounded()
            reader = Reader(self.path)
            reader.open()
            inner = reader.storage
            self._packed = inner.metadata.compression_mode == "message"
            if self._packed:  # unpacked here, with a bound
                inner.metadata = inner.metadata._replace(compression_mode=None)
            self._open = reader
            finalize(self, _closed, reader)
        return self._open

    def _store(self, kind: str) -> Any:
        """What knows a type: by the definition in the bag, or, where there is none, ROS 2's own."""
        defined = next((c.msgdef for c in self._reader().connections if c.msgtype == kind), None)
        return _types(kind, defined)

    def close(self) -> None:
        """Let the files go; the bag opens again when it is read."""
        reader, self._open = self._open, None
        if reader is not None:
            _closed(reader)

    def messages(
        self, names: Collection[str] = (), *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Topic, time of recording and bytes (CDR) of each message, by time of recording.

        Args:
            names: Topics; all where there are none.
            start_ns: From this time on.
            stop_ns: Before this time.

        Raises:
            FileFormatError: If the bag is damaged, or read whole gives another number of messages than it says.
        """
        topics = {topic.name: topic for topic in self.topics if not names or topic.name in names}
        counts = dict.fromkeys(topics, 0)
        with guarded(self.path, "the messages"):
            reader = self._reader()
            chosen = [connection for connection in reader.connections if connection.topic in topics]
            source = reader.messages(chosen, start_ns, stop_ns) if chosen else iter(())
        while (record := _next(self.path, source, sum(counts.values()))) is not None:
            connection, log_ns, raw = record
            if len(raw) > _MAX_MESSAGE_BYTES:
                raise _wrong(self.path, sum(counts.values()), f"at most {_MAX_MESSAGE_BYTES} bytes", f"{len(raw)}")
            if self._packed:
                with guarded(self.path, f"message {sum(counts.values())}"):
                    raw = unpacked_message(raw)
            counts[connection.topic] += 1
            yield topics[connection.topic], int(log_ns), bytes(raw)
        for name, topic in topics.items():
            if start_ns is None and stop_ns is None and counts[name] != topic.size:
                raise FileFormatError(
                    self.path, where=f"topic {name}", expected=f"{topic.size} messages",
                    got=f"{counts[name]}", fix="The bag is cut; `ros2 bag reindex` may save what is left.",
                )  # fmt: skip

    def stamps(self, names: Collection[str] = ()) -> dict[str, Stamps]:
        """When the messages of each topic were recorded and taken; reads the whole bag once.

        A message's own stamp is its header's, for types that begin with one.
        """
        log: dict[str, list[int]] = {topic.name: [] for topic in self.topics if not names or topic.name in names}
        header: dict[str, list[int]] = {name: [] for name in log}
        headed = {topic.name: self._is_headed(topic.kind) for topic in self.topics}
        for number, (topic, log_ns, raw) in enumerate(self.messages(names)):
            log[topic.name].append(log_ns)
            if headed[topic.name]:
                header[topic.name].append(header_ns(self.path, number, raw))
        return {
            name: Stamps(
                np.array(times, dtype=np.int64),
                np.array(header[name], dtype=np.int64) if headed[name] else None,
            )
            for name, times in log.items()
        }

    def _is_headed(self, kind: str) -> bool:
        if kind.split("/")[1:2] != ["msg"]:  # services and actions
            return False
        with guarded(self.path, f"the definition of {kind}"):
            fields = self._store(kind).fielddefs.get(kind, ((), ()))[1]
            return bool(fields) and fields[0][1][1] == HEADER

    def decode(self, topic: Topic, raw: bytes) -> Any:
        """A message's fields, by the definition in the bag.

        Raises:
            FileFormatError: If the bytes do not fit the definition.
        """
        with guarded(self.path, f"a message of {topic.name} ({topic.kind})"):
            return self._store(topic.kind).deserialize_cdr(raw, topic.kind)

    def at(self, name: str, log_ns: int, repeat: int = 0) -> Any:
        """The message of a topic that was recorded at a moment, decoded; the ``repeat``-th where there are several.

        Raises:
            FileFormatError: If there is none.
        """
        for number, (topic, _, raw) in enumerate(self.messages([name], start_ns=log_ns, stop_ns=log_ns + 1)):
            if number == repeat:
                return self.decode(topic, raw)
        raise FileFormatError(self.path, where=f"topic {name}", expected=f"a message at {log_ns} ns", got="none")


def header_ns(path: Path, number: int, raw: bytes) -> int:
    """The stamp at the beginning of a message in CDR: four bytes of encoding, then seconds and nanoseconds."""
    order: Any = "little" if len(raw) > 1 and raw[1] & 1 else "big"
    seconds = int.from_bytes(raw[4:8], order, signed=True)
    fraction = int.from_bytes(raw[8:12], order)
    if len(raw) < 12 or fraction >= 1_000_000_000:
        raise _wrong(path, number, "a header with a stamp", f"{len(raw)} bytes, {fraction} ns")
    return seconds * 1_000_000_000 + fraction


@lru_cache(maxsize=256)
def _types(kind: str, defined: Any) -> Any:
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if defined is None or defined.format == MessageDefinitionFormat.NONE:
        return get_typestore(Stores.LATEST)
    store = get_typestore(Stores.EMPTY)
    by_msg = defined.format == MessageDefinitionFormat.MSG
    store.register(get_types_from_msg(defined.data, kind) if by_msg else get_types_from_idl(defined.data))
    return store


def _closed(reader: Any) -> None:
    if reader.is_open:
        reader.close()


def _next(path: Path, source: Iterator[Any], number: int) -> Any:
    with guarded(path, f"message {number}"):
        return next(source, None)


def _check_size(path: Path) -> None:
    """Refuse an SQLite file that is shorter than its header says (SQLite's file format, 1.3.8)."""
    with path.open("rb") as handle:
        head = handle.read(100)
    size = path.stat().st_size
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    claimed_bytes = page * int.from_bytes(head[28:32], "big")
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0") or size < claimed_bytes:
        raise FileFormatError(
            path, where="the file", expected=f"an SQLite file of {claimed_bytes} bytes", got=f"{size} bytes"
        )


@contextmanager
def guarded(path: Path | str, where: str) -> Iterator[None]:
    """Turn whatever the library raises over a damaged bag into the error of a damaged file."""
    try:
        yield
    except FarfieldError:
        raise
    except Exception as error:  # the library lets Unicode, key, memory and other errors of damaged bytes through
        actual = f"{type(error).__name__}: {error}"[:200]
        fix = "A recorder that was killed leaves no end; `ros2 bag reindex` may save what is left."
        raise FileFormatError(path, where=where, expected="a whole bag", got=actual, fix=fix) from error


def _wrong(path: Path, number: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"message {number}", expected=expected, got=actual)


# Bags that would fill the memory or the disk: sizes that records claim are checked before anything is unpacked.
#
# A record is an opcode, its length (8 bytes) and its content; a chunk (opcode 6) holds two times, the size that it
# unpacks to, a checksum, the name of the compression, and the packed bytes behind their length (https://mcap.dev/spec).
# A chunk of a few kilobytes of zstd may unpack to terabytes, whatever size it claims.

MOST_BYTES = 1 << 30
"""No chunk unpacks to more."""
FREE_BYTES, MOST_TIMES = 64 << 20, 256
"""Beyond so many bytes, a chunk unpacks to at most so many times its packed size."""
_MAGIC, _CHUNK, _HEAD = b"\x89MCAP0\r\n", 6, 36


def allowed_bytes(packed: int) -> int:
    """To how many bytes so many packed ones may unpack."""
    return min(MOST_BYTES, FREE_BYTES + MOST_TIMES * packed)


def check_records(path: Path) -> None:
    """Walk through a file's records without reading their content; a file that is no MCAP is left to its reader.

    Raises:
        FileFormatError: If a record claims to end beyond the file, or a chunk to unpack to absurdly much.
    """
    size, number = path.stat().st_size, 0
    with path.open("rb") as handle:
        if handle.read(len(_MAGIC)) != _MAGIC:
            return
        while handle.tell() < size - len(_MAGIC):
            head = handle.read(9)
            length, offset = int.from_bytes(head[1:], "little"), handle.tell()
            if len(head) < 9 or offset + length > size:
                raise _too_large(path, number, f"a record that ends within the file's {size} bytes", f"{length} bytes")
            if head[0] == _CHUNK:
                _check_chunk(path, number, handle.read(min(length, _HEAD + 64)), length)
            handle.seek(offset + length)
            number += 1


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
    with path.open("rb") as handle:
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


def _check_chunk(path: Path, number: int, head: bytes, length: int) -> None:
    unpacked, name = int.from_bytes(head[16:24], "little"), int.from_bytes(head[28:32], "little")
    packed = int.from_bytes(head[32 + name : 40 + name], "little")
    if len(head) < 40 + name or packed > length:
        raise _too_large(path, number, f"a chunk within its record of {length} bytes", f"{packed} packed bytes")
    if unpacked > allowed_bytes(packed):
        expected = f"a chunk of {packed} bytes that unpacks to at most {allowed_bytes(packed)}"
        raise _too_large(path, number, expected, f"one that claims {unpacked}")


def _too_large(path: Path, number: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"record {number}", expected=expected, got=actual)


def bounded() -> None:
    """Make rosbags unpack a chunk to no more than the size that it claims, which is refused where it is absurd."""
    from rosbags.rosbag2 import storage_mcap

    decompressors: dict[str, Any] = storage_mcap.DECOMPRESSORS
    for name in ("zstd", "lz4"):
        if name in decompressors and not isinstance(decompressors[name], partial):
            decompressors[name] = partial(unpacked, name)


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
    """Unpack a file that was packed as a whole (``compression_mode: file``), without keeping anything, up to a bound.

    Raises:
        FileFormatError: If it unpacks to more than 256 times its size and 64 MiB.
    """
    try:
        from rosbags.rosbag2.storage_mcap import zstd
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "Reading ROS 2 bags") from error
    size, unpacked_bytes = path.stat().st_size, 0
    most = FREE_BYTES + MOST_TIMES * size
    try:
        with zstd.open(path, "rb") as handle:
            while block := handle.read(1 << 20):
                unpacked_bytes += len(block)
                if unpacked_bytes > most:
                    raise FileFormatError(
                        path, where="the file", expected=f"at most {most} bytes when unpacked", got="more"
                    )
    except (OSError, EOFError, zstd.ZstdError) as error:
        raise FileFormatError(path, where="the file", expected="a file packed with zstd", got=str(error)) from error
