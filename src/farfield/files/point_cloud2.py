"""``sensor_msgs/msg/PointCloud2``: fields at any offset, of any type and byte order, padded points and rows."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FileFormatError
from farfield.files.bags import guarded

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""``PointField``'s codes."""


def read_points(message: Any, path: Path | str) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The columns of a cloud, row after row, in the machine's byte order; a field of several numbers is ``name_0``...

    Args:
        message: With the fields of the type: ``height``, ``width``, ``fields``, ``is_bigendian``, ``point_step``,
            ``row_step``, ``data``.
        path: For error messages.

    Raises:
        FileFormatError: If a field's type is unknown, a name stands twice, or sizes contradict each other.
    """
    with guarded(path, "a point cloud"):  # a damaged definition leaves fields out
        return _columns(message, path)


def _columns(message: Any, path: Path | str) -> dict[str, Shaped[np.ndarray, " n"]]:
    height, width, step, row = (int(getattr(message, n)) for n in ("height", "width", "point_step", "row_step"))
    data = np.asarray(message.data, dtype=np.uint8)
    order = ">" if message.is_bigendian else "<"
    names: dict[str, tuple[str, int]] = {}
    for field in message.fields:
        code, count, offset = int(field.datatype), max(int(field.count), 1), int(field.offset)
        if code not in TYPES:
            raise _wrong(path, f"field {field.name}", f"a type from 1 to 8, {_said()}", f"{code}")
        size = np.dtype(TYPES[code]).itemsize
        if offset + count * size > step:
            raise _wrong(path, f"field {field.name}", f"bytes within a point of {step}", f"{offset} + {count} x {size}")
        for place in range(count):
            name = field.name if count == 1 else f"{field.name}_{place}"
            if name in names:
                raise _wrong(path, f"field {name}", "one of each name", "two")
            names[name] = (order + TYPES[code], offset + place * size)
    rows = row if height > 1 else width * step
    if width * step > rows or (height - 1) * rows + width * step > len(data) or (height and not step):
        raise _wrong(
            path, "the sizes", f"{height} rows of {rows} bytes, {width} points of {step}", f"{len(data)} bytes"
        )
    whole: Any = {
        "names": list(names),
        "formats": [form for form, _ in names.values()],
        "offsets": [offset for _, offset in names.values()],
        "itemsize": step,
    }
    points: Any = (
        np.ndarray((height, width), np.dtype(whole), buffer=data, strides=(rows, step)) if height * width else None
    )
    empty: Any = np.zeros(0, dtype=np.dtype(whole))
    table = empty if points is None else points
    native = {name: np.dtype(form).newbyteorder("=") for name, (form, _) in names.items()}
    return {name: np.ascontiguousarray(table[name]).astype(native[name]).reshape(-1) for name in names}


def _said() -> str:
    return ", ".join(f"{code} {name}" for code, name in TYPES.items())


def _wrong(path: Path | str, where: str, expected: str, found: str) -> FileFormatError:
    return FileFormatError(path, where=f"a point cloud, {where}", expected=expected, found=found)
