"""ROS bags: of ROS 2 folders with ``metadata.yaml``, or a lone ``.mcap`` or ``.db3`` file; of ROS 1 a ``.bag`` file.

They are read through ``rosbags``, ROS 1's records by :mod:`farfield.files.ros1_bags` and their messages through it.

Whatever a damaged bag makes of the library becomes a :class:`FileFormatError`, and a bag that gives fewer messages than
it says is damaged. A changed payload is seen only where the format has a checksum (MCAP's chunks, if the writer filled
it in); SQLite has none, and an altered message without a checksum reads as another message. What would unpack to
absurdly much is refused before it is (:mod:`farfield.files.bag_guard`).
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np
import yaml
from jaxtyping import Int64

from farfield.errors import FarfieldError, FileFormatError, MissingExtraError, plain
from farfield.files.atomic import read_bytes
from farfield.files.bag_guard import SUFFIXES, bounded, check_packed_file, check_storage, unpacked_message
from farfield.files.limits import MAX_BYTES
from farfield.files.remote_paths import as_path, local_folder
from farfield.files.ros1_bags import REINDEX, Ros1Reader
from farfield.files.ros1_bags import SUFFIX as ROS1_SUFFIX
from farfield.files.stand_ins import check_itself
from farfield.files.suffixes import any_case
from farfield.files.yaml_text import MAX_BYTES as YAML_BYTES
from farfield.files.yaml_text import plain_yaml

_SUFFIX_OF = {"mcap": ".mcap", "sqlite3": ".db3"}  # by storage_identifier
FILE_SUFFIXES = (*SUFFIXES, ROS1_SUFFIX)
"""Endings of the names of files that are a bag by themselves."""
HEADER = "std_msgs/msg/Header"
_LATEST_NS = 1 << 62
_FREE_MESSAGES, _LEAST_MESSAGE_BYTES = 100_000, 4  # of a bag, packed: an MCAP's message has 31 bytes and its content
_MAX_DEFINITION_BYTES, _MAX_FIXED = 1 << 16, 4096


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
        return path.suffix.lower() in FILE_SUFFIXES
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
        self.path = as_path(path)
        self._open: Any = None
        self._packed = False
        self.is_ros1 = self.path.is_file() and self.path.suffix.lower() == ROS1_SUFFIX
        for part in _parts(self.path) if self.path.is_dir() else [self.path]:
            check_itself(part)
            if part.suffix.lower() == ".zstd":
                check_packed_file(part)
            else:
                check_storage(part)
        with guarded(self.path, "the bag"):
            reader = self._reader()
            self.topics = tuple(
                Topic(str(name), str(topic.msgtype), int(topic.msgcount))
                for name, topic in sorted(reader.topics.items())
            )
            claimed_count = int(reader.message_count)
        if (counted := sum(topic.size for topic in self.topics)) != claimed_count:
            raise _wrong(self.path, counted, f"{claimed_count} messages in all topics", f"{counted}")
        parts = [self.path] if self.path.is_file() else filter(Path.is_file, self.path.iterdir())
        most = _FREE_MESSAGES + sum(part.stat().st_size for part in parts) // _LEAST_MESSAGE_BYTES
        if claimed_count > most:
            raise _wrong(self.path, 0, f"at most {most} messages in a bag of its size", f"{claimed_count}")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": None}

    def _reader(self) -> Any:
        if self._open is None:
            try:
                from rosbags.rosbag2 import Reader
            except ImportError as error:
                raise MissingExtraError("rosbags", "bags", "Reading ROS bags") from error
            if self.is_ros1:
                self._open = Ros1Reader(self.path)
                finalize(self, _closed, self._open)
                return self._open
            with bounded():
                reader = Reader(local_folder(self.path))
                reader.open()
            inner = reader.storage
            self._packed = inner.metadata.compression_mode == "message"
            if self._packed:  # unpacked here, with a bound
                inner.metadata = inner.metadata._replace(compression_mode=None)
            self._open = reader
            finalize(self, _closed, reader)
        return self._open

    def _store(self, kind: str) -> Any:
        """What knows a type: by the definition in the bag, or, where there is none, ROS' own."""
        connection = next((c for c in self._reader().connections if c.msgtype == kind), None)
        defined = None if connection is None else connection.msgdef
        return _types(kind, defined, connection.md5sum if self.is_ros1 and connection is not None else None)

    def close(self) -> None:
        """Let the files go; the bag opens again when it is read."""
        reader, self._open = self._open, None
        if reader is not None:
            _closed(reader)

    def messages(
        self, names: Collection[str] = (), *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Topic, time of recording and bytes (CDR, or ROS 1's) of each message, by time of recording.

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
            if not 0 <= log_ns < _LATEST_NS:
                expected = f"a time of recording from 0 to {_LATEST_NS} ns"
                raise _wrong(self.path, sum(counts.values()), expected, f"{log_ns} ns")
            if len(raw) > MAX_BYTES:
                raise _wrong(self.path, sum(counts.values()), f"at most {MAX_BYTES} bytes", f"{len(raw)}")
            if self._packed:
                with guarded(self.path, f"message {sum(counts.values())}"):
                    raw = unpacked_message(raw)
            counts[connection.topic] += 1
            if counts[connection.topic] > topics[connection.topic].size:
                size = topics[connection.topic].size
                raise _wrong(self.path, size, f"{size} messages of {connection.topic}", "more")
            yield topics[connection.topic], int(log_ns), bytes(raw)
        for name, topic in topics.items():
            if start_ns is None and stop_ns is None and counts[name] != topic.size:
                raise FileFormatError(
                    self.path, where=f"topic {name}", expected=f"{topic.size} messages",
                    got=f"{counts[name]}", fix=f"The bag is cut; {_saving(self.path)}",
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
                header[topic.name].append(header_ns(self.path, number, raw, ros1=self.is_ros1))
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
            store = self._store(topic.kind)
            parse = store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr
            return parse(raw, topic.kind)

    def at(self, name: str, log_ns: int, repeat: int = 0) -> Any:
        """The message of a topic that was recorded at a moment, decoded; the ``repeat``-th where there are several.

        Raises:
            FileFormatError: If there is none.
        """
        for number, (topic, _, raw) in enumerate(self.messages([name], start_ns=log_ns, stop_ns=log_ns + 1)):
            if number == repeat:
                return self.decode(topic, raw)
        raise FileFormatError(self.path, where=f"topic {name}", expected=f"a message at {log_ns} ns", got="none")


def _parts(folder: Path) -> list[Path]:
    """The files of a bag's folder that are read: ``metadata.yaml``, first, and those that it names or that look so.

    Raises:
        FileFormatError: If the metadata are no YAML within bounds, or name a file of another kind.
    """
    metadata = folder / "metadata.yaml"
    if not metadata.exists():
        raise FileFormatError(folder, where="the folder", expected="a bag's metadata.yaml", got="none")
    content = read_bytes(metadata, max_bytes=YAML_BYTES)
    try:
        information = plain_yaml(content)["rosbag2_bagfile_information"]
        named = {folder / PurePath(name).name for name in information["relative_file_paths"]}
        storage = _SUFFIX_OF.get(str(information["storage_identifier"]))
    except (yaml.YAMLError, KeyError, TypeError) as error:
        raise FileFormatError(metadata, where="the file", expected="a bag's metadata", got=plain(error)) from error
    suffixes = (*SUFFIXES, ".zstd")
    if others := sorted(path.name for path in named if path.suffix.lower() not in suffixes):
        expected, got = f"files of the kinds {', '.join(suffixes)}", f"{others[0]!r}"
        raise FileFormatError(metadata, where="relative_file_paths", expected=expected, got=got[:80])
    kinds = {path.name: Path(path.stem if path.suffix.lower() == ".zstd" else path).suffix.lower() for path in named}
    if storage and (others := sorted(name for name, kind in kinds.items() if kind != storage)):
        expected, got = f"files of the kind {storage}, as storage_identifier says", f"{others[0]!r}"
        raise FileFormatError(metadata, where="relative_file_paths", expected=expected, got=got[:80])
    return [metadata, *(path for path in sorted(folder.iterdir()) if path.suffix.lower() in suffixes)]


def header_ns(path: Path, number: int, raw: bytes, *, ros1: bool = False) -> int:
    """The stamp at the beginning of a message: four bytes, then seconds and nanoseconds.

    The four bytes are CDR's encoding, or ROS 1's counter, whose seconds have no sign.
    """
    order: Any = "little" if ros1 or (len(raw) > 1 and raw[1] & 1) else "big"
    seconds = int.from_bytes(raw[4:8], order, signed=not ros1)
    fraction = int.from_bytes(raw[8:12], order)
    if len(raw) < 12 or fraction >= 1_000_000_000:
        raise _wrong(path, number, "a header with a stamp", f"{len(raw)} bytes, {fraction} ns")
    return seconds * 1_000_000_000 + fraction


@lru_cache(maxsize=256)
def _types(kind: str, defined: Any, md5sum: str | None) -> Any:
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if defined is None or defined.format == MessageDefinitionFormat.NONE:
        store = get_typestore(Stores.LATEST if md5sum is None else Stores.ROS1_NOETIC)
        _check_digest(store, kind, md5sum)
        return store
    if len(defined.data) > _MAX_DEFINITION_BYTES:
        raise ValueError(f"a definition of {len(defined.data)} bytes, more than {_MAX_DEFINITION_BYTES}")
    store = get_typestore(Stores.EMPTY)
    by_msg = defined.format == MessageDefinitionFormat.MSG
    types = get_types_from_msg(defined.data, kind) if by_msg else get_types_from_idl(defined.data)
    _check_fields(types)
    store.register(types)
    _check_digest(store, kind, md5sum)
    return store


def _check_digest(store: Any, kind: str, md5sum: str | None) -> None:
    """Refuse a definition of ROS 1 that is another than the one that its checksum is of; ``*`` is of any.

    Raises:
        ValueError: If it is.
    """
    if md5sum in (None, "*"):
        return
    actual = store.generate_msgdef(kind)[1]
    if actual != md5sum:
        raise ValueError(f"the definition of {kind} has the md5sum {actual}, the connection says {str(md5sum)[:40]!r}")


def _check_fields(types: Mapping[str, Any]) -> None:
    """Refuse types of which a few bytes become many objects, or code without end, when they are decoded.

    Raises:
        ValueError: If an array of texts or messages has a fixed length beyond reason, or messages in a list no bytes.
    """
    from rosbags.interfaces import Nodetype

    for name, (_, fields) in types.items():
        for field, (node, value) in fields:
            if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                continue
            (inner, inner_value), length = value
            is_plain = inner == Nodetype.BASE and inner_value[0] != "string"
            if node == Nodetype.ARRAY and not is_plain and length > _MAX_FIXED:
                raise ValueError(f"{name}.{field}: an array of {length} texts or messages")
            if inner == Nodetype.NAME and inner_value in types and not types[inner_value][1]:
                raise ValueError(f"{name}.{field}: a list of messages without fields")


def _closed(reader: Any) -> None:
    if reader.is_open:
        reader.close()


def _next(path: Path, source: Iterator[Any], number: int) -> Any:
    with guarded(path, f"message {number}"):
        return next(source, None)


@contextmanager
def guarded(path: Path | str, where: str) -> Iterator[None]:
    """Turn whatever the library raises over a damaged bag into the error of a damaged file."""
    try:
        yield
    except FarfieldError:
        raise
    except Exception as error:  # the library lets Unicode, key, memory and other errors of damaged bytes through
        actual = f"{type(error).__name__}: {error}"[:200]
        fix = f"A recorder that was killed leaves no end; {_saving(Path(path))}"
        raise FileFormatError(path, where=where, expected="a whole bag", got=actual, fix=fix) from error


def _saving(path: Path) -> str:
    command = REINDEX if path.suffix.lower() == ROS1_SUFFIX else "ros2 bag reindex"
    return f"`{command}` may save what is left."


def _wrong(path: Path, number: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"message {number}", expected=expected, got=actual)
