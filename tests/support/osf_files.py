"""OSF files made byte by byte after the schemas: tables, pictures, sweeps and whole recordings of one sensor."""

import io
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from farfield.datasets.osf import Osf

zstandard = pytest.importorskip("zstandard")


BEAMS, COLUMNS = 4, 64
ORIGIN_MM = 15.806
SHIFTS = [3, 1, -1, -3]
START_NS = 5_000_000_000

Fields = dict[int, Any]
"""A table: numbers as (kind, value), bytes, arrays, texts, and lists of tables, by slot."""


def table(fields: Fields) -> bytes:
    """A table with its list of fields before it and what it holds behind it; its first byte follows the list."""
    slots = max(fields, default=-1) + 1
    entries, inline, behind = [0] * slots, b"", b""
    held = []
    for slot, value in fields.items():
        entries[slot] = 4 + len(inline)
        if isinstance(value, tuple):
            inline += struct.pack("<" + value[0], value[1])
        else:
            held.append((4 + len(inline), value))
            inline += bytes(4)
    listed = struct.pack(f"<HH{slots}H", 4 + 2 * slots, 4 + len(inline), *entries)
    body = bytearray(struct.pack("<i", len(listed)) + inline)
    for at, value in held:
        start = len(body) + len(behind)
        if isinstance(value, list):
            offsets, tables = b"", b""
            for number, child in enumerate(value):
                content = table(child)
                own = 4 + 4 * len(value) + len(tables) + first_byte(content)
                offsets += struct.pack("<I", own - 4 - 4 * number)
                tables += content
            behind += struct.pack("<I", len(value)) + offsets + tables
        else:
            content = value.encode() if isinstance(value, str) else bytes(value)
            behind += struct.pack("<I", len(value)) + content
        body[at : at + 4] = struct.pack("<I", start - at)
    return listed + bytes(body) + behind


def first_byte(content: bytes) -> int:
    return int(struct.unpack("<H", content[:2])[0])


def buffer(fields: Fields, mark: bytes = b"") -> bytes:
    """A table as a buffer, behind its size."""
    content = table(fields)
    head = struct.pack("<I", 4 + len(mark) + first_byte(content)) + mark + content
    return struct.pack("<I", len(head)) + head


def checked(content: bytes) -> bytes:
    return content + struct.pack("<I", zlib.crc32(content))


class Structs:
    """A vector of structs: so many items of some bytes."""

    def __init__(self, count: int, content: bytes) -> None:
        self.count, self.content = count, content

    def __len__(self) -> int:
        return self.count

    def __bytes__(self) -> bytes:
        return self.content


def array(values: Any, dtype: str) -> Structs:
    numbers = np.asarray(values, dtype=dtype)
    return Structs(numbers.size, numbers.tobytes())


def zpng(picture: np.ndarray) -> bytes:
    """A picture as differences to the left; four-byte pixels as planes b, g - b, g - r, a."""
    height, width = picture.shape
    bytes_of = picture.view(np.uint8).reshape(height, width, -1)
    steps = np.diff(bytes_of, axis=1, prepend=np.zeros_like(bytes_of[:, :1]))
    if steps.shape[2] == 4:
        red, green, blue, alpha = (steps[:, :, number] for number in range(4))
        content = np.stack([blue, green - blue, green - red, alpha]).tobytes()
    else:
        content = steps.tobytes()
    channels = (4, 1) if steps.shape[2] == 4 else (1, steps.shape[2])
    return struct.pack("<HHHBB", 0xFBF8, width, height, *channels) + zstandard.compress(content)


def png(picture: np.ndarray) -> bytes:
    """A picture whose rows are shifted so that columns show one direction."""
    rows = np.stack([np.roll(row, shift) for row, shift in zip(picture, SHIFTS, strict=True)])
    image = Image.fromarray(rows.view(np.uint8).reshape(*rows.shape, 4) if rows.itemsize == 4 else rows)
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()


RANGE_MM = np.array(
    [
        [0 if (beam + column) % 5 == 0 else 70_000 + 100 * column + beam for column in range(COLUMNS)]
        for beam in range(BEAMS)
    ],
    dtype=np.uint32,
)
REFLECTIVITY = np.array([[(7 * column + beam) % 256 for column in range(COLUMNS)] for beam in range(BEAMS)], np.uint8)
NEAR_IR = (RANGE_MM % 5000).astype(np.uint16)
METADATA = {
    "build_rev": "v2.3.0",
    "prod_sn": "992000000001",
    "beam_altitude_angles": [10.0, 0.0, -5.0, -10.0],
    "beam_azimuth_angles": [3.0, 1.0, -1.0, -3.0],
    "lidar_origin_to_beam_origin_mm": ORIGIN_MM,
    "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1],
    "data_format": {
        "columns_per_frame": COLUMNS,
        "columns_per_packet": 16,
        "pixels_per_column": BEAMS,
        "column_window": [0, COLUMNS - 1],
        "pixel_shift_by_row": SHIFTS,
        "udp_profile_lidar": "RNG15_RFL8_WIN8",
    },
}


def sweep(number: int, pack: Any = zpng, **changed: Any) -> bytes:
    """A message of a sweep: range, reflectivity, near infrared, a second range."""
    times = START_NS + 100_000_000 * number + np.arange(COLUMNS) * 1_000_000
    pictures = {
        1: (3, RANGE_MM),
        5: (1, REFLECTIVITY),
        7: (2, NEAR_IR),
        2: (3, np.where(RANGE_MM % 3, 0, RANGE_MM + 500)),
    }
    fields: Fields = {
        0: [
            {0: pack(np.ascontiguousarray(picture.astype(f"u{[0, 1, 2, 4][kind]}")))}
            for kind, picture in pictures.values()
        ],
        1: Structs(len(pictures), bytes(byte for name, (kind, _) in pictures.items() for byte in (name, kind))),
        2: array(times, "<u8"),
        4: array(np.ones(COLUMNS), "<u4"),
    }
    return buffer(fields | {int(slot[1:]): value for slot, value in changed.items()})


def recording(
    sweeps: list[bytes],
    *,
    version: int = 2 << 48 | 2 << 32,
    status: int = 2,
    metadata: dict[str, Any] | None = None,
    further: list[Fields] | None = None,
) -> bytes:
    """A whole file: a chunk of all sweeps, and the list."""
    described = buffer({0: json.dumps(metadata or METADATA)})
    stream = buffer({0: ("I", 1)})
    chunk = checked(buffer({0: [{0: ("Q", 1), 1: ("I", 2), 2: content} for content in sweeps]}, b"OSF!"))
    entries = [
        {0: ("I", 1), 1: "ouster/v1/os_sensor/LidarSensor", 2: described},
        {0: ("I", 2), 1: "ouster/v1/os_sensor/LidarScanStream", 2: stream},
        *(further or []),
    ]
    listed = checked(buffer({3: Structs(1, struct.pack("<QQQ", 1, 1, 0)), 4: entries}, b"OSF#"))
    head = buffer({0: ("Q", version), 1: ("B", status), 2: ("Q", 0), 3: ("Q", 0)}, b"OSF$")
    start = len(checked(head))
    head = buffer({0: ("Q", version), 1: ("B", status), 2: ("Q", start + len(chunk)), 3: ("Q", 0)}, b"OSF$")
    return checked(head) + chunk + listed


def opened(folder: Path, content: bytes) -> Osf:
    (folder / "a.osf").write_bytes(content)
    return Osf(folder)
