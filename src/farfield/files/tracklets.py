"""KITTI raw's ``tracklet_labels.xml``, which CVAT exports too: objects with a pose in each frame of a drive.

An object has ``objectType``, ``h``, ``w``, ``l``, ``first_frame`` and ``poses`` of consecutive frames: ``tx ty tz`` is
the centre of the bottom in the LiDAR's frame, ``rz`` the yaw in radians. A pose also says ``occlusion`` (0 to 2; -1
unknown) and ``truncation`` (0 in the image, 1 cut, 2 outside, 3 behind; 99 unknown).
(Geiger et al., raw data devkit readme.)
"""

import math
from pathlib import Path

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, Value, checked, word
from farfield.files.xml_tree import Element, parse_xml

_MOST_FRAMES = 1_000_000


def parse_tracklets(data: bytes, path: Path | str) -> tuple[Cuboid, ...]:
    """A box for each object and frame; the frame's name is its number, the track the object's place in the file.

    Raises:
        FileFormatError: If it is not of this form.
    """
    root = parse_xml(data, path)
    held = root.all("tracklets")
    if len(held) != 1:
        raise FileFormatError(path, where="the root", expected="one element tracklets", got=f"{len(held)}")
    return tuple(cuboid for number, item in enumerate(held[0].all("item")) for cuboid in _boxes(item, number, path))


def _boxes(item: Element, number: int, path: Path | str) -> list[Cuboid]:
    where = f"tracklet {number}"
    label = word(item.get("objectType") or None, path, where, "objectType")
    height, width, length = (_number(item, name, path, where) for name in ("h", "w", "l"))
    first = _number(item, "first_frame", path, where)
    if first != int(first) or not 0 <= first < _MOST_FRAMES:
        raise FileFormatError(path, where=where, expected="a frame number as first_frame", got=repr(first))
    poses = [pose for group in item.all("poses") for pose in group.all("item")]
    boxes = []
    for step, pose in enumerate(poses):
        here = f"{where}, pose {step}"
        x, y, bottom, yaw = (_number(pose, name, path, here) for name in ("tx", "ty", "tz", "rz"))
        box = checked((x, y, bottom + height / 2), (length, width, height), yaw, path, here)
        frame = str(int(first) + step)
        boxes.append(Cuboid(frame=frame, label=label, box=box, track=str(number), attributes=_seen(pose)))
    return boxes


def _seen(pose: Element) -> dict[str, Value]:
    values = {name: pose.get(name) for name in ("occlusion", "truncation")}
    return {name: float(text) for name, text in values.items() if text in ("-1", "0", "1", "2", "3", "99")}


def _number(element: Element, name: str, path: Path | str, where: str) -> float:
    text = element.get(name)
    try:
        value = float(text) if text is not None and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileFormatError(path, where=where, expected=f"a number as {name}", got=repr(text)[:60])
    return value
