"""SUSTechPOINTS' label files: one JSON list a frame.

``label/<frame>.json``::

    [{"obj_id": "4", "obj_type": "Car", "obj_attr": "parked",
      "psr": {"position": {"x", "y", "z"}, "scale": {"x", "y", "z"}, "rotation": {"x", "y", "z"}}}]

Position is the centre, scale the full length, width and height, rotation Euler angles in radians about the axes x, y, z
that turn with the box; z is the yaw. Coordinates are the LiDAR's, z up. (From the tool's documentation and its sample.)
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, checked, word, wrapped, xyz
from farfield.files.json_text import append, parse_json

MAX_BYTES = 16 << 20


def parse_sustechpoints(data: bytes, path: Path | str) -> tuple[CuboidEntry, ...]:
    """The boxes of one file; ``obj_attr`` is an attribute.

    Raises:
        FileFormatError: If it is not of this form.
    """
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    if not isinstance(content, list):
        raise FileFormatError(path, where="the root", expected="a list of objects", got=type(content).__name__)
    return tuple(
        CuboidEntry((number,), _cuboid(entry, path, f"object {number}")) for number, entry in enumerate(content)
    )


def _cuboid(entry: Any, path: Path | str, where: str) -> Cuboid:
    psr = entry.get("psr") if isinstance(entry, dict) else None
    if not isinstance(psr, dict):
        raise FileFormatError(path, where=where, expected="an object with psr", got=repr(entry)[:80])
    centre, size, turn = (xyz(psr.get(name), path, where, name) for name in ("position", "scale", "rotation"))
    track, remark = entry.get("obj_id"), entry.get("obj_attr")
    return Cuboid(
        label=word(entry.get("obj_type"), path, where, "obj_type"),
        box=checked(centre, size, turn[2], path, where, tilt_rad=turn[:2]),
        track="" if track in (None, "", -1, "-1") else word(track, path, where, "obj_id"),
        attributes={"obj_attr": remark} if isinstance(remark, str) and remark else {},
    )


def values(cuboid: Cuboid) -> Mapping[tuple[str | int, ...], Any]:
    """What a label entry says of a cuboid, by the way to it in the entry."""
    paths = [("psr", part, axis) for part in ("position", "scale") for axis in "xyz"]
    changes: dict[tuple[str | int, ...], Any] = dict(zip(paths, cuboid.box[:6], strict=True))
    changes |= {("psr", "rotation", "z"): wrapped(cuboid.box[6])}
    changes |= {("obj_type",): cuboid.label, ("obj_id",): cuboid.track}
    return changes | ({("obj_attr",): cuboid.attributes["obj_attr"]} if "obj_attr" in cuboid.attributes else {})


def entry_of(cuboid: Cuboid) -> dict[str, Any]:
    """A whole new entry."""
    x, y, z, length, width, height, yaw = cuboid.box
    entry: dict[str, Any] = {
        "psr": {
            "position": {"x": x, "y": y, "z": z},
            "scale": {"x": length, "y": width, "z": height},
            "rotation": {"x": 0, "y": 0, "z": wrapped(yaw)},
        },
        "obj_type": cuboid.label,
        "obj_id": cuboid.track,
    }
    return entry | ({"obj_attr": cuboid.attributes["obj_attr"]} if "obj_attr" in cuboid.attributes else {})


def with_new(text: str, cuboid: Cuboid) -> str:
    """A file's text with an entry more."""
    return append(text, (), entry_of(cuboid))


def format_sustechpoints(cuboids: Sequence[Cuboid]) -> str:
    """A new file's text."""
    return json.dumps([entry_of(cuboid) for cuboid in cuboids], indent=1) + "\n"


def format_calibration(camera_T_lidar: Float[np.ndarray, "4 4"], matrix: Float[np.ndarray, "3 3"]) -> str:
    """A camera's calibration, ``calib/camera/<name>.json``: both matrices row by row; distortion has no place."""
    content = {"extrinsic": camera_T_lidar.ravel().tolist(), "intrinsic": matrix.ravel().tolist()}
    return json.dumps(content, indent=1) + "\n"
