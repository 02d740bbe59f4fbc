"""LAS files by hand, byte for byte as the specification of ASPRS 1.4 - R15 has them."""

import struct
from collections.abc import Sequence

HEADER_BYTES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}


def las_bytes(
    points: Sequence[bytes],
    *,
    minor: int = 2,
    point_format: int = 1,
    encoding: int = 0,
    scale: tuple[float, float, float] = (0.001, 0.001, 0.001),
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    bounds: tuple[float, float, float, float, float, float] = (0, 0, 0, 0, 0, 0),
    records: Sequence[tuple[str, int, bytes]] = (),
    extended: Sequence[tuple[str, int, bytes]] = (),
    count: int | None = None,
    old_count: int | None = None,
    by_return: tuple[int, ...] = (0, 0, 0, 0, 0),
    point_bytes: int | None = None,
    tail: bytes = b"",
) -> bytes:
    """A file of points that are packed already; ``bounds`` are max x, min x, max y, min y, max z, min z."""
    count = len(points) if count is None else count
    body = b"".join(points)
    vlrs = b"".join(
        struct.pack("<H16sHH32s", 0, user.encode(), number, len(data), b"") + data for user, number, data in records
    )
    evlrs = b"".join(
        struct.pack("<H16sHQ32s", 0, user.encode(), number, len(data), b"") + data for user, number, data in extended
    )
    size = HEADER_BYTES[minor]
    start = size + len(vlrs)
    legacy = (count if minor < 4 or point_format < 6 else 0) if old_count is None else old_count
    width = (len(points[0]) if points else 28) if point_bytes is None else point_bytes
    head = struct.pack("<4sHHIHH8sBB32s32sHHHIIBHI", b"LASF", 0, encoding, 0, 0, 0, b"", 1, minor, b"", b"hand", 1,
                       2024, size, start, len(records), point_format, width, legacy)  # fmt: skip
    head += struct.pack("<5I", *by_return) + struct.pack("<12d", *scale, *offset, *bounds)
    if minor >= 3:
        head += struct.pack("<Q", 0)
    if minor >= 4:
        head += struct.pack(
            "<QIQ15Q", start + len(body) if extended else 0, len(extended), count, *by_return, *[0] * 10
        )
    assert len(head) == size
    return head + vlrs + body + evlrs + tail


def point_1(x: int, y: int, z: int, strength: int = 0, *, flags: int = 0, time: float = 0.0) -> bytes:
    """A point of format 1; ``flags`` are classification (5 bits), synthetic, key point, withheld."""
    return struct.pack("<iiiHBBbBHd", x, y, z, strength, 0b01_001_001, flags, -5, 17, 42, time)


def point_7(x: int, y: int, z: int, strength: int = 0, *, flags: int = 0, time: float = 0.0) -> bytes:
    """A point of format 7; ``flags`` are synthetic, key point, withheld, overlap, channel (2 bits), direction, edge."""
    return struct.pack("<iiiHBBBBhHdHHH", x, y, z, strength, 0x32, flags, 200, 17, -5000, 42, time, 1, 2, 65535)


def geo_keys(**codes: int) -> tuple[str, int, bytes]:
    """The record of GeoTIFF's keys; ``k1024=1`` says that the model is a projection."""
    rows = [(int(key[1:]), 0, 1, value) for key, value in codes.items()]
    return (
        "LASF_Projection",
        34735,
        struct.pack("<4H", 1, 1, 0, len(rows)) + b"".join(struct.pack("<4H", *row) for row in rows),
    )


def wkt(text: str) -> tuple[str, int, bytes]:
    """The record of a coordinate system in WKT."""
    return "LASF_Projection", 2112, text.encode() + b"\0"


def extra_bytes(name: str, kind: int, *, options: int = 0, scale: float = 0.0, offset: float = 0.0) -> bytes:
    """The description of extra bytes of one number."""
    return struct.pack("<HBB32s4s24s24s24s", 0, kind, options, name.encode(), b"", b"", b"", b"") + struct.pack(
        "<d16xd16x32s", scale, offset, b""
    )
