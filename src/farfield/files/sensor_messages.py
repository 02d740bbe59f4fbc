"""``sensor_msgs/msg/PointCloud2``: fields at any offset, of any type and byte order, padded points and rows."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped, UInt8

from farfield.errors import FileFormatError
from farfield.files.bags import guarded
from farfield.files.images import decode_image
from farfield.files.limits import MAX_PIXELS, check_numbers

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""``PointField``'s codes."""


def read_points(message: Any, path: Path | str) -> dict[str, Shaped[np.ndarray, "..."]]:
    """The columns of a cloud, row after row, in the machine's byte order: (n,), or (n, count) of several numbers each.

    Args:
        message: With the fields of the type: ``height``, ``width``, ``fields``, ``is_bigendian``, ``point_step``,
            ``row_step``, ``data``.
        path: For error messages.

    Raises:
        FileFormatError: If a field's type is unknown, a name stands twice, or sizes contradict each other.
    """
    with guarded(path, "a point cloud"):  # a damaged definition leaves fields out
        return _columns(message, path)


def _columns(message: Any, path: Path | str) -> dict[str, Shaped[np.ndarray, "..."]]:
    height, width, step, row = (int(getattr(message, n)) for n in ("height", "width", "point_step", "row_step"))
    data = np.asarray(message.data, dtype=np.uint8)
    order = ">" if message.is_bigendian else "<"
    fields: dict[str, tuple[Any, int]] = {}
    check_numbers(path, "a point cloud's fields", sum(max(int(field.count), 1) for field in message.fields))
    for field in message.fields:
        code, count, offset = int(field.datatype), max(int(field.count), 1), int(field.offset)
        if code not in TYPES:
            types = ", ".join(f"{number} {name}" for number, name in TYPES.items())
            raise _wrong(path, f"field {field.name}", f"a type from 1 to 8, {types}", f"{code}")
        size = np.dtype(TYPES[code]).itemsize
        if offset + count * size > step:
            raise _wrong(path, f"field {field.name}", f"bytes within a point of {step}", f"{offset} + {count} x {size}")
        if field.name in fields:
            raise _wrong(path, f"field {field.name}", "one of each name", "two")
        kind = np.dtype(order + TYPES[code])
        fields[str(field.name)] = (kind if count == 1 else np.dtype((kind, (count,))), offset)
    used = width * step
    rows = row if height > 1 or row >= used else used  # some drivers leave it 0 where there is one row
    least, most = (height - 1) * rows + used, height * rows
    present = min(rows, len(data))  # a filter may leave the length of a row as it was
    left_over = height == 1 and step and present >= used + step  # whole points that the width does not count
    if used > rows or left_over or (height and not least <= len(data) <= max(most, used)) or (height and not step):
        raise _wrong(
            path, "the sizes", f"{height} rows of {rows} bytes, {width} points of {step}", f"{len(data)} bytes"
        )
    columns: Any = {
        "names": [*fields],
        "formats": [kind for kind, _ in fields.values()],
        "offsets": [offset for _, offset in fields.values()],
        "itemsize": step,
    }
    points: Any = (
        np.ndarray((height, width), np.dtype(columns), buffer=data, strides=(rows, step)) if height * width else None
    )
    table: Any = (np.zeros(0, dtype=np.dtype(columns)) if points is None else points).reshape(-1)
    return {
        name: np.ascontiguousarray(table[name]).astype(kind.base.newbyteorder("="))
        for name, (kind, _) in fields.items()
    }


def _wrong(path: Path | str, where: str, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"a point cloud, {where}", expected=expected, got=actual)


# ``sensor_msgs/msg/Image`` and ``CompressedImage`` as RGB.

CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "mono8": (0, 0, 0)}
_SIZES = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}


def read_ros_image(message: Any, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    """An ``Image`` of eight bits a channel as RGB, without the padding of its rows.

    Raises:
        FileFormatError: If its encoding is another, or its sizes contradict each other.
    """
    with guarded(path, "an image"):  # a damaged definition leaves fields out
        return _pixels(message, path)


def _pixels(message: Any, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    height, width, step = int(message.height), int(message.width), int(message.step)
    encoding, data = str(message.encoding), np.asarray(message.data, dtype=np.uint8)
    if encoding not in CHANNELS:
        names = ", ".join(CHANNELS)
        raise FileFormatError(path, where="an image's encoding", expected=f"one of {names}", got=repr(encoding[:40]))
    row = width * _SIZES[encoding]
    if height * width > MAX_PIXELS or step < row or len(data) < (height - 1) * step + row or not height * width:
        actual = f"{len(data)} bytes for {width} x {height} in rows of {step}"
        raise FileFormatError(path, where="an image", expected=f"rows of {row} bytes or more, all there", got=actual)
    padded = np.zeros(height * step, dtype=np.uint8)
    padded[: min(len(data), len(padded))] = data[: len(padded)]
    pixels = padded.reshape(height, step)[:, :row].reshape(height, width, -1)
    return np.ascontiguousarray(pixels[:, :, list(CHANNELS[encoding])])


def read_ros_compressed(message: Any, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    """A ``CompressedImage`` that holds a JPEG or a PNG as RGB.

    Raises:
        FileFormatError: If it holds something else, such as depth or video.
    """
    with guarded(path, "a compressed image"):
        kind, data = str(message.format), np.asarray(message.data, dtype=np.uint8).tobytes()
    if "compressedDepth" in kind:
        raise FileFormatError(path, where="a compressed image", expected="a JPEG or PNG", got=f"depth ({kind[:60]!r})")
    return decode_image(io.BytesIO(data), path, max_pixels=MAX_PIXELS)
