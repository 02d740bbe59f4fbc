"""Captured network traffic (libpcap's ``.pcap`` and ``.pcapng``): the UDP datagrams, put together where IP cut them.

The forms are those of libpcap's ``pcap-savefile(5)`` and of the IETF's draft-ietf-opsawg-pcapng; Ethernet (with VLAN
tags), raw IP, loopback and Linux' cooked captures are read, IPv4 and IPv6 in each (RFC 791, RFC 8200, RFC 768).
"""

import ipaddress
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Int64

from farfield.errors import FileFormatError
from farfield.files.limits import open_file
from farfield.files.stand_ins import check_itself

Span = tuple[int, int]
"""Where a piece of a datagram stands in the file: its first byte and its length."""

_MAGIC_STEP_NS = {0xA1B2C3D4: 1_000, 0xA1B23C4D: 1}
_PCAPNG, _PCAPNG_ORDER = b"\x0a\x0d\x0d\x0a", 0x1A2B3C4D
_SECTION, _INTERFACE, _SIMPLE_PACKET, _PACKET = 0x0A0D0D0A, 1, 3, 6
_RESOLUTION, _TIME_OFFSET = 9, 14  # options of an interface
_LINK_BYTES = {1: 14, 101: 0, 12: 0, 228: 0, 229: 0, 0: 4, 113: 16, 276: 20}
"""Bytes before the IP header by type of link: Ethernet, raw IP, loopback, cooked 1 and 2."""
_ETHERNET, _LOOPBACK, _COOKED, _COOKED_2 = 1, 0, 113, 276
_IP_TYPES, _VLANS, _UDP = (b"\x08\x00", b"\x86\xdd"), (0x8100, 0x88A8), 17
_FRAGMENT_HEADER, _OPTION_HEADERS = 44, (0, 43, 60)  # of IPv6: hop by hop, routing, destination
_MOST_BYTES = 1 << 18  # a record: libpcap's own limit
_MOST_BLOCK_BYTES = 1 << 24  # a block of pcapng of another kind, which is passed over
_MOST_INTERFACES = 1 << 16
_MOST_HEAD_BYTES = 256  # before the IP header: a few tags of four bytes
_MOST_OPEN, _MOST_PIECES = 1024, 500_000  # datagrams of which fragments are awaited, and these: some 100 MB
_PATIENCE_NS = 15_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Datagram:
    """One UDP datagram of a capture.

    Args:
        time_ns: When it was captured, nanoseconds since 1970.
        source: IPv4 or IPv6 address that it came from.
        port: The port that it was sent to.
        spans: Where its content stands in the file, in order: first byte and length of each piece, shape (k, 2).
    """

    time_ns: int
    source: bytes
    port: int
    spans: Int64[np.ndarray, "k 2"]

    @property
    def size(self) -> int:
        """Bytes of the content."""
        return int(self.spans[:, 1].sum())

    def content(self, file: BinaryIO) -> bytes:
        """The content, from the open capture."""
        pieces = []
        for start, length in self.spans.tolist():
            file.seek(start)
            pieces.append(file.read(length))
        return b"".join(pieces)


def address_of(source: bytes) -> str:
    """An IP address as it is written.

    >>> address_of(bytes([192, 168, 1, 201]))
    '192.168.1.201'
    """
    return str(ipaddress.ip_address(source))


@dataclass
class Losses:
    """What a capture lacks, counted while its datagrams are read.

    Args:
        cut: Packets of which the capture kept but the first bytes (a snap length).
        incomplete: Datagrams of which fragments are missing.
        torn: Whether the file ends within a record: it was cut, or is still written.
    """

    cut: int = 0
    incomplete: int = 0
    torn: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence on each."""
        cut = f"{self.cut} packets are kept only in part (tcpdump -s 0 keeps them whole) and not read."
        incomplete = f"{self.incomplete} datagrams lack fragments and are not read."
        torn = "The file ends within a packet: it was cut, or is still written; what came later is not read."
        sentences = {cut: self.cut, incomplete: self.incomplete, torn: self.torn}
        return tuple(sentence for sentence, applies in sentences.items() if applies)


class _CapturedPacket(NamedTuple):
    """A captured packet: where its bytes stand, they themselves, when they came, and how many there were."""

    at: int
    packet: bytes
    time_ns: int
    link: int
    sent_bytes: int


def datagrams(path: Path, losses: Losses | None = None, most_records: int | None = None) -> Iterator[Datagram]:
    """The UDP datagrams of a capture in its order; other traffic is passed over, and a cut last record ends it.

    Args:
        path: The capture, ``.pcap`` or ``.pcapng``.
        losses: Counts what is missing.
        most_records: How many records are looked at, of whatever traffic; None: all.

    Raises:
        FileFormatError: If it is no capture, of a type of link that is not read, or damaged.
    """
    check_itself(path)
    losses = Losses() if losses is None else losses
    with open_file(path, max_bytes=None) as file:
        head = file.read(24)
        records = _pcapng_records if head[:4] == _PCAPNG else _pcap_records
        fragmented = Fragmented(losses)
        for record in islice(records(path, file, head, losses), most_records):
            fragment = _fragment(record, losses)
            whole = None if fragment is None else fragmented.completed(fragment)
            if fragment is not None and whole is not None:
                port, spans = whole
                yield Datagram(record.time_ns, fragment.source, port, np.array(spans, dtype=np.int64))
        losses.incomplete += len(fragmented.awaited)


def _pcap_records(path: Path, file: BinaryIO, head: bytes, losses: Losses) -> Iterator[_CapturedPacket]:
    """The records of a ``.pcap`` whose first 24 bytes were read."""
    order, step_ns, link = _header(path, head)
    at = 24
    while len(record := file.read(16)) == 16:
        seconds, fraction, length, sent_bytes = struct.unpack(order + "IIII", record)
        _check_length(path, at, length)
        packet = file.read(length)
        if len(packet) < length:
            break
        yield _CapturedPacket(at + 16, packet, seconds * 1_000_000_000 + fraction * step_ns, link, sent_bytes)
        at += 16 + length
        record = b""
    losses.torn = bool(record)


def _check_length(path: Path, at: int, length: int) -> None:
    if length > _MOST_BYTES:
        where = f"the record at byte {at}"
        raise FileFormatError(path, where=where, expected=f"at most {_MOST_BYTES} bytes", got=f"{length} bytes")


def _header(path: Path, head: bytes) -> tuple[str, int, int]:
    """Byte order, nanoseconds of a step of the fraction, and type of link."""
    for order in "<>" if len(head) == 24 else "":
        magic, link = struct.unpack(order + "I16xI", head)
        if magic in _MAGIC_STEP_NS:
            link &= 0xFFFF  # above stands the length of check sums
            _check_link(path, link)
            return order, _MAGIC_STEP_NS[magic], link
    got = head[:4].hex(" ") or "an empty file"
    raise FileFormatError(path, where="the header", expected="a .pcap or .pcapng", got=got)


def _check_link(path: Path, link: int) -> None:
    if link not in _LINK_BYTES:
        expected = "Ethernet, raw IP, loopback or a cooked capture"
        raise FileFormatError(path, where="the header", expected=expected, got=f"link type {link}")


@dataclass(frozen=True)
class _Interface:
    """Where packets of a ``.pcapng`` came from: type of link, bytes kept of each, parts of a second, and offset."""

    link: int
    snap_bytes: int
    steps_per_s: int = 1_000_000
    offset_s: int = 0


def _pcapng_records(path: Path, file: BinaryIO, head: bytes, losses: Losses) -> Iterator[_CapturedPacket]:
    """The packets of a ``.pcapng``, block by block; a section begins its interfaces anew."""
    del head
    file.seek(0)
    order, interfaces, at = "<", list[_Interface](), 0
    while len(start := file.read(12)) == 12:
        if start[:4] == _PCAPNG:
            order = "<" if struct.unpack("<I", start[8:])[0] == _PCAPNG_ORDER else ">"
            if struct.unpack(order + "I", start[8:])[0] != _PCAPNG_ORDER:
                where = f"the section at byte {at}"
                raise FileFormatError(path, where=where, expected="1a2b3c4d", got=start[8:].hex(" "))
            interfaces = []
        kind, size = struct.unpack(order + "II", start[:8])
        if not 12 <= size <= _MOST_BLOCK_BYTES or size % 4:
            expected = f"a multiple of 4 from 12 to {_MOST_BLOCK_BYTES} bytes"
            raise FileFormatError(path, where=f"the block at byte {at}", expected=expected, got=f"{size} bytes")
        rest = file.read(size - 12)
        if len(rest) < size - 12:
            break
        body = (start[8:] + rest)[:-4]
        if (start[8:] + rest)[-4:] != start[4:8]:
            expected = f"its length {size} once more at its end"
            raise FileFormatError(path, where=f"the block at byte {at}", expected=expected, got="another number")
        if kind == _INTERFACE:
            if len(interfaces) == _MOST_INTERFACES:
                expected = f"at most {_MOST_INTERFACES} interfaces"
                raise FileFormatError(path, where=f"the block at byte {at}", expected=expected, got="more")
            interfaces.append(_interface(path, order, at, body))
        elif kind in (_PACKET, _SIMPLE_PACKET):
            yield _block_record(path, order, at, body, interfaces, simple=kind == _SIMPLE_PACKET)
        at += size
        start = b""
    losses.torn = bool(start)


def _interface(path: Path, order: str, at: int, body: bytes) -> _Interface:
    """An interface's description: its type of link and how its times count."""
    if len(body) < 8:
        raise FileFormatError(path, where=f"the interface at byte {at}", expected="8 bytes", got=f"{len(body)} bytes")
    link, snap_bytes = struct.unpack(order + "H2xI", body[:8])
    _check_link(path, link)
    steps_per_s, offset_s, start = 1_000_000, 0, 8
    while start + 4 <= len(body):
        code, length = struct.unpack(order + "HH", body[start : start + 4])
        value = body[start + 4 : start + 4 + length]
        if code == _RESOLUTION and len(value) == 1:
            power = value[0] & 0x7F
            if power > (62 if value[0] & 0x80 else 18):
                where = f"the interface at byte {at}"
                raise FileFormatError(path, where=where, expected="a resolution of times", got=f"byte {value[0]}")
            steps_per_s = 2**power if value[0] & 0x80 else 10**power
        if code == _TIME_OFFSET and len(value) == 8:
            offset_s = struct.unpack(order + "q", value)[0]
        start += 4 + (length + 3) // 4 * 4
    return _Interface(link, snap_bytes, steps_per_s, offset_s)


def _block_record(
    path: Path, order: str, at: int, body: bytes, interfaces: list[_Interface], *, simple: bool
) -> _CapturedPacket:
    """The packet of a block; a simple one has no time and comes from the first interface."""
    head_bytes = 4 if simple else 20
    number, high, low, length, sent_bytes = 0, 0, 0, 0, 0
    if len(body) >= head_bytes:
        numbers = struct.unpack(order + ("I" if simple else "IIIII"), body[:head_bytes])
        number, high, low, length, sent_bytes = (0, 0, 0, *numbers, *numbers) if simple else numbers
    if len(body) < head_bytes or number >= len(interfaces):
        expected = f"a packet of one of {len(interfaces)} interfaces"
        raise FileFormatError(path, where=f"the block at byte {at}", expected=expected, got=f"interface {number}")
    interface = interfaces[number]
    if simple:
        length = min(length, interface.snap_bytes or length)
    _check_length(path, at, length)
    if head_bytes + length > len(body):
        got = f"{len(body) - head_bytes}"
        raise FileFormatError(path, where=f"the block at byte {at}", expected=f"{length} bytes", got=f"{got} bytes")
    time_ns = (high << 32 | low) * 1_000_000_000 // interface.steps_per_s + interface.offset_s * 1_000_000_000
    if not -(1 << 62) < time_ns < 1 << 62:
        raise FileFormatError(path, where=f"the block at byte {at}", expected="a time", got=f"{time_ns} ns")
    packet = body[head_bytes : head_bytes + length]
    return _CapturedPacket(at + 8 + head_bytes, packet, time_ns, interface.link, sent_bytes)


@dataclass(frozen=True, slots=True)
class Fragment:
    """What one IP packet holds of a datagram.

    Args:
        key: Addresses and identity, the same in all fragments of a datagram.
        source: The address that it came from.
        offset: Where in the datagram it begins, in bytes.
        span: Where it stands in the file.
        last: Whether none follows.
        time_ns: When it was captured.
        head: Its first eight bytes: of the first fragment the UDP header.
    """

    key: bytes
    source: bytes
    offset: int
    span: Span
    last: bool
    time_ns: int
    head: bytes


def _fragment(record: _CapturedPacket, losses: Losses) -> Fragment | None:
    """The fragment in a captured packet; None of other traffic, and of packets that were kept in part."""
    packet = record.packet
    start = _ip_start(packet, record.link)
    if start is None or len(packet) < start + 20:
        return None
    version = packet[start] >> 4
    parts = _ipv4(packet, start) if version == 4 else _ipv6(packet, start) if version == 6 else None
    if parts is None:
        return None
    key, source, flags, body, end = parts
    if end > len(packet):
        losses.cut += 1
        return None
    last, offset = not flags & 0x2000, 8 * (flags & 0x1FFF)
    head = packet[body : body + 8]
    return Fragment(key, source, offset, (record.at + body, end - body), last, record.time_ns, head)


_Parts = tuple[bytes, bytes, int, int, int]
"""Key, source, IPv4's flags with the offset in eights, where the content begins, and where it ends."""


def _ipv4(packet: bytes, start: int) -> _Parts | None:
    """The parts of an IPv4 packet; None of other traffic than UDP."""
    total, flags = struct.unpack(">2xH2xH", packet[start : start + 8])
    body, end = start + 4 * (packet[start] & 15), start + total
    if packet[start + 9] != _UDP or not start + 20 <= body < end:
        return None
    source = packet[start + 12 : start + 16]
    return packet[start + 4 : start + 6] + packet[start + 12 : start + 20], source, flags, body, end


def _ipv6(packet: bytes, start: int) -> _Parts | None:
    """The parts of an IPv6 packet; None of other traffic than UDP."""
    if len(packet) < start + 40:
        return None
    end = start + 40 + int.from_bytes(packet[start + 4 : start + 6], "big")
    following, body = packet[start + 6], start + 40
    identity, flags = b"", 0
    while following in (*_OPTION_HEADERS, _FRAGMENT_HEADER) and body + 8 <= min(end, len(packet)):
        if following == _FRAGMENT_HEADER:
            word = int.from_bytes(packet[body + 2 : body + 4], "big")
            identity, flags = packet[body + 4 : body + 8], (word & 1) << 13 | word >> 3
        size = 8 if following == _FRAGMENT_HEADER else 8 * (packet[body + 1] + 1)
        following, body = packet[body], body + size
    if following != _UDP or body >= end:
        return None
    return identity + packet[start + 8 : start + 40], packet[start + 8 : start + 24], flags, body, end


def _ip_start(packet: bytes, link: int) -> int | None:
    """Where the IP header of a packet begins; None of other protocols."""
    start = _LINK_BYTES[link]
    if link in (_ETHERNET, _COOKED):
        while int.from_bytes(packet[start - 2 : start], "big") in _VLANS and start < _MOST_HEAD_BYTES:
            start += 4
        return start if packet[start - 2 : start] in _IP_TYPES else None
    return None if link == _COOKED_2 and packet[:2] not in _IP_TYPES else start


@dataclass(slots=True)
class _Awaited:
    """Fragments of one datagram: where they stand, by offset, their bytes, and where the last one ends."""

    begun_ns: int
    pieces: dict[int, Span] = field(default_factory=dict)
    size: int = 0
    end: int | None = None
    head: bytes = b""

    def add(self, fragment: Fragment) -> None:
        if fragment.offset not in self.pieces:
            self.size += fragment.span[1]
        self.pieces[fragment.offset] = fragment.span
        if not fragment.offset:
            self.head = fragment.head
        if fragment.last:
            self.end = fragment.offset + fragment.span[1]


@dataclass
class Fragmented:
    """Datagrams of which fragments are awaited: for 15 s (RFC 791), the oldest forgotten beyond the limits."""

    losses: Losses
    awaited: dict[bytes, _Awaited] = field(default_factory=dict)
    pieces: int = 0

    def completed(self, fragment: Fragment) -> tuple[int, tuple[Span, ...]] | None:
        """Port and content of the datagram that a fragment completes; None while some are missing."""
        state = self.awaited.get(fragment.key)
        if state is None or abs(fragment.time_ns - state.begun_ns) > _PATIENCE_NS:
            self.losses.incomplete += self._forget(fragment.key)
            state = self.awaited[fragment.key] = _Awaited(fragment.time_ns)
        before = len(state.pieces)
        state.add(fragment)
        self.pieces += len(state.pieces) - before
        if state.size != state.end:
            while len(self.awaited) > _MOST_OPEN or self.pieces > _MOST_PIECES:
                self.losses.incomplete += self._forget(next(iter(self.awaited)))
            return None
        self._forget(fragment.key)
        offsets = sorted(state.pieces)
        spans = [state.pieces[offset] for offset in offsets]
        ends = [offset + length for offset, (_, length) in zip(offsets, spans, strict=True)]
        if offsets[0] or offsets[1:] != ends[:-1] or ends[-1] < 8 or len(state.head) < 8:
            self.losses.incomplete += 1
            return None
        port, length = struct.unpack(">2xHH2x", state.head)
        spans[0] = (spans[0][0] + 8, spans[0][1] - 8)
        if length != ends[-1]:
            self.losses.incomplete += 1
            return None
        return port, tuple(spans)

    def _forget(self, key: bytes) -> int:
        """Wait no longer for a datagram's fragments; how many datagrams that were, 0 or 1."""
        state = self.awaited.pop(key, None)
        self.pieces -= 0 if state is None else len(state.pieces)
        return int(state is not None)
