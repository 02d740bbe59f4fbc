"""Packets of sensors and captures of them, byte by byte after the manuals, by a hand that has not seen the readers."""

import struct
from collections.abc import Callable, Sequence

Shot = Callable[[int, int, int], tuple[int, int]]
"""Range in steps and reflectivity by direction in hundredths of a degree, laser and return."""

START_NS = 1_700_000_000_000_000_000


def velodyne_packet(
    model: int, mode: int, stamp_us: int, azimuths: Sequence[int], shot: Shot, *, lasers: int = 32
) -> bytes:
    """A packet of the directions of its firings: blocks of 32 shots, in pairs with two returns, a bank a block."""
    returns = 2 if mode == 0x39 else 1
    blocks = []
    for azimuth in azimuths:
        for bank in range(max(lasers // 32, 1)):
            for number in range(returns):
                shots = [shot(azimuth, (32 * bank + laser) % lasers, number) for laser in range(32)]
                head = struct.pack("<HH", 0xEEFF - 0x1100 * bank, azimuth % 36000)
                blocks.append(head + b"".join(struct.pack("<HB", *values) for values in shots))
    empty = [struct.pack("<HH", 0, 0) + bytes(96)] * (12 - len(blocks))
    packet = b"".join(blocks + empty) + struct.pack("<IBB", stamp_us % 3_600_000_000, mode, model)
    assert len(packet) == 1206
    return packet


def xt32_packet(
    azimuths: Sequence[int], shot: Shot, *, mode: int, second: int, time_us: int, step_mm: int = 4
) -> bytes:
    """A packet of a PandarXT-32: eight blocks of 32 beams, on 1 March 2024 at noon."""
    returns = 2 if mode in (0x39, 0x3B) else 1
    header = b"\xee\xff\x06\x01\x00\x00" + bytes([32, 8, 1, step_mm, returns, 1])
    blocks = b"".join(
        struct.pack("<H", azimuth)
        + b"".join(struct.pack("<HBB", *shot(azimuth, beam, number), 255) for beam in range(32))
        for azimuth in azimuths
        for number in range(returns)
    )
    date = bytes([124, 3, 1, 12, 0, second])
    tail = bytes(10) + bytes([mode]) + struct.pack("<H", 600) + date + struct.pack("<I", time_us) + b"\x42" + bytes(4)
    assert len(header + blocks + tail) == 1080
    return header + blocks + tail


def pandar40p_packet(azimuths: Sequence[int], shot: Shot, *, second: int, time_us: int) -> bytes:
    """A packet of a Pandar40P with the strongest returns: ten blocks of 40 beams."""
    blocks = b"".join(
        b"\xff\xee"
        + struct.pack("<H", azimuth)
        + b"".join(struct.pack("<HB", *shot(azimuth, beam, 0)) for beam in range(40))
        for azimuth in azimuths
    )
    tail = bytes(8) + struct.pack("<HIBB", 600, time_us, 0x37, 0x42) + bytes([24, 3, 1, 12, 0, second])
    assert len(blocks + tail) == 1262
    return blocks + tail


def udp4(payload: bytes, *, source: bytes = b"\xc0\xa8\x01\xc9", port: int = 2368) -> bytes:
    """An Ethernet frame with a datagram over IPv4."""
    datagram = struct.pack(">HHHH", 2368, port, len(payload) + 8, 0) + payload
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(datagram), 0, 0, 64, 17, 0, source, b"\xff" * 4)
    return bytes(12) + b"\x08\x00" + head + datagram


def udp6(payload: bytes, *, fragment: int = 0, identity: int = 7) -> list[bytes]:
    """Ethernet frames with a datagram over IPv6, behind a header of options, cut into fragments of some bytes."""
    datagram = struct.pack(">HHHH", 2368, 2368, len(payload) + 8, 0) + payload
    step = fragment or len(datagram)
    frames = []
    for start in range(0, len(datagram), step):
        piece = datagram[start : start + step]
        more = int(start + step < len(datagram))
        extra = struct.pack(">BBHI", 17, 0, start | more, identity) if fragment else b""
        options = bytes([44 if fragment else 17, 0]) + bytes(6)
        body = options + extra + piece
        head = struct.pack(">IHBB", 6 << 28, len(body), 0, 64) + bytes(15) + b"\x01" + bytes(15) + b"\x02"
        frames.append(bytes(12) + b"\x86\xdd" + head + body)
    return frames


def pcap(frames: Sequence[bytes], times_ns: Sequence[int] | None = None, *, order: str = "<") -> bytes:
    """A ``.pcap`` with nanoseconds."""
    times_ns = [START_NS] * len(frames) if times_ns is None else times_ns
    records = [
        struct.pack(order + "IIII", time_ns // 10**9, time_ns % 10**9, len(frame), len(frame)) + frame
        for time_ns, frame in zip(times_ns, frames, strict=True)
    ]
    return struct.pack(order + "IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 1 << 18, 1) + b"".join(records)


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """A block of a ``.pcapng``."""
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + size + body + size


def pcapng(frames: Sequence[bytes], times_ns: Sequence[int], *, order: str = "<", resolution: int = 9) -> bytes:
    """A ``.pcapng`` of one section and interface; its times count in parts of a second, 10 or 2 to the resolution."""
    section = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)
    options = struct.pack(order + "HHB3xHH", 9, 1, resolution, 0, 0)
    interface = block(1, struct.pack(order + "HHI", 1, 0, 0) + options, order)
    steps = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    records = [section, interface]
    for time_ns, frame in zip(times_ns, frames, strict=True):
        ticks = time_ns * steps // 10**9
        head = struct.pack(order + "IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
        records.append(block(6, head + frame, order))
    return b"".join(records)
