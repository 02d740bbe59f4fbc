"""KITTI raw's ``tracklet_labels.xml``, which CVAT exports too: objects with a pose in each frame of a drive.

An object has ``objectType``, ``h``, ``w``, ``l``, ``first_frame`` and ``poses`` of consecutive frames: ``tx ty tz`` is
the centre of the bottom in the LiDAR's frame, ``rz`` the yaw in radians. A pose also says ``occlusion`` (0 to 2; -1
unknown) and ``truncation`` (0 in the image, 1 cut, 2 outside, 3 behind; 99 unknown).
(Geiger et al., raw data devkit readme.)

CVAT and Datumaro write the same elements with another meaning (:data:`CONVENTIONS`): ``tx ty tz`` is the centre, and
``h``, ``w``, ``l`` are sizes along axes, of which ``l`` is the vertical one. Beside the file their ``frame_list.txt``
names the sweep of each frame number: ``0 0000000005``.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, Value, checked, word
from farfield.files.xml_tree import Element, parse_xml

_MOST_FRAMES = 1_000_000
_MAX_LIST_BYTES = 16 << 20
_OUTSIDE = ("2", "3")  # of CVAT and Datumaro: the object is not there, and the pose fills the gap between two others

ConventionName = Literal["kitti", "cvat", "datumaro"]


@dataclass(frozen=True)
class Convention:
    """What the numbers of an object stand for.

    Args:
        name: Its name.
        sizes: The elements that hold length, width and height.
        bottom: Whether ``tz`` is the bottom's height, else the centre's.
    """

    name: ConventionName
    sizes: tuple[str, str, str]
    bottom: bool


CONVENTIONS: dict[ConventionName, Convention] = {
    "kitti": Convention("kitti", ("l", "w", "h"), bottom=True),
    "cvat": Convention("cvat", ("h", "w", "l"), bottom=False),
    "datumaro": Convention("datumaro", ("w", "h", "l"), bottom=False),
}
"""KITTI's own; CVAT's, whose h, w, l are the sizes along x, y, z; later Datumaro's, whose w, h, l are."""


def parse_tracklets(data: bytes, path: Path | str, convention: Convention = CONVENTIONS["kitti"]) -> tuple[Cuboid, ...]:
    """A box for each object and frame; the frame's name is its number, the track the object's place in the file.

    Args:
        data: The file's bytes.
        path: The file, for messages.
        convention: What its numbers stand for.

    Raises:
        FileFormatError: If it is not of this form.
    """
    items = enumerate(_objects(data, path))
    return tuple(cuboid for number, item in items for cuboid in _boxes(item, number, path, convention))


def tracklet_writer(data: bytes, path: Path | str) -> str:
    """Who wrote a file, by the marks in it: ``"kitti"``, ``"tool"`` (CVAT or Datumaro), or empty where it bears none.

    A list of poses is of version 2 in KITTI's files and of 0 in Datumaro's, whose every amount is -1.

    Raises:
        FileFormatError: If it is not of this form.
    """
    groups = [group for item in _objects(data, path) for group in item.all("poses")]
    versions = {group.get("item_version") for group in groups}
    if versions in ({"0"}, {"2"}):
        return "tool" if versions == {"0"} else "kitti"
    amounts = {pose.get("amt_occlusion_kf") for group in groups for pose in group.all("item")}
    return "tool" if amounts == {"-1"} else ""


def parse_frame_list(data: bytes, path: Path | str) -> dict[int, str]:
    """The name of the sweep of each frame number, from ``frame_list.txt``: ``NUMBER NAME`` a line.

    Raises:
        FileFormatError: If a line is not of this form, or a number or a name stands twice.
    """
    if len(data) > _MAX_LIST_BYTES:
        raise FileFormatError(path, where="the file", expected=f"at most {_MAX_LIST_BYTES} bytes", got=f"{len(data)}")
    names: dict[int, str] = {}
    sweeps: set[str] = set()
    for line, text in enumerate(data.decode("utf-8-sig", errors="replace").splitlines(), start=1):
        if not text.strip() or text.startswith("#"):
            continue
        number, name = [*text.split(maxsplit=1), ""][:2]
        name = name.strip()
        if not (number.isascii() and number.isdigit() and len(number) < 10 and name):
            raise FileFormatError(path, where=f"line {line}", expected="NUMBER NAME", got=repr(text[:80]))
        if int(number) in names or name in sweeps:
            expected = "each number and each name once"
            raise FileFormatError(path, where=f"line {line}", expected=expected, got=repr(text[:80]))
        names[int(number)] = name
        sweeps.add(name)
    return names


def _objects(data: bytes, path: Path | str) -> list[Element]:
    root = parse_xml(data, path)
    tracklets = root.all("tracklets")
    if len(tracklets) != 1:
        raise FileFormatError(path, where="the root", expected="one element tracklets", got=f"{len(tracklets)}")
    return tracklets[0].all("item")


def _boxes(item: Element, number: int, path: Path | str, convention: Convention) -> list[Cuboid]:
    where = f"tracklet {number}"
    label = word(item.get("objectType") or None, path, where, "objectType")
    length, width, height = (_number(item, name, path, where) for name in convention.sizes)
    first = _number(item, "first_frame", path, where)
    if first != int(first) or not 0 <= first < _MOST_FRAMES:
        raise FileFormatError(path, where=where, expected="a frame number as first_frame", got=repr(first))
    poses = [pose for group in item.all("poses") for pose in group.all("item")]
    boxes = []
    for step, pose in enumerate(poses):
        if not convention.bottom and pose.get("truncation") in _OUTSIDE:
            continue
        here = f"{where}, pose {step}"
        x, y, z, yaw = (_number(pose, name, path, here) for name in ("tx", "ty", "tz", "rz"))
        centre = (x, y, z + height / 2 if convention.bottom else z)
        tilt = [_number(pose, name, path, here) for name in ("rx", "ry") if pose.get(name) is not None]
        box = checked(centre, (length, width, height), yaw, path, here, tilt_rad=tilt)
        frame = str(int(first) + step)
        boxes.append(Cuboid(frame=frame, label=label, box=box, track=str(number), attributes=_seen(pose)))
    return boxes


def _seen(pose: Element) -> dict[str, Value]:
    values = {name: pose.get(name) for name in ("occlusion", "truncation")}
    return {name: float(text) for name, text in values.items() if text in ("-1", "0", "1", "2", "3", "99")}


def _number(element: Element, name: str, path: Path | str, where: str) -> float:
    text = element.get(name)
    try:
        value = float(text) if text is not None and text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileFormatError(path, where=where, expected=f"a number as {name}", got=repr(text)[:60])
    return value
