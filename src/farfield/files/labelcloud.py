"""labelCloud's label files: one JSON a cloud, in one of three forms.

Its forms (https://ch-sa.github.io/labelCloud, conventions and README; a whole file in the project's issue 1)::

    {"folder": "pointclouds", "filename": "a.pcd", "path": "pointclouds/a.pcd", "objects": [
      {"name": "car", "centroid": {"x", "y", "z"}, "dimensions": {"length", "width", "height"},
       "rotations": {"x", "y", "z"}},
      {"name": "car", "vertices": [[x, y, z], ...]}]}

``centroid_rel`` has its rotations in radians from -pi to pi, ``centroid_abs`` in degrees from 0 to 360; nothing in a
file names its form. ``vertices`` are the eight corners, the bottom's before the top's: left back, left front, right
front, right back; the length runs from the left side to the right, where the tool's arrow points. Rotations count
counter-clockwise, as the conventions say; the README also names the other direction, which is why ``vertices`` are
written.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from farfield.errors import FileFormatError
from farfield.files.cuboids import Cuboid, CuboidEntry, attributes_of, checked, numbers, word, xyz
from farfield.files.json_text import append, finite, parse_json, plain_json, set_value

MAX_BYTES = 16 << 20
ANGLES = ("radians", "degrees")
Angles = Literal["radians", "degrees"]
Form = Literal["centroid_rel", "centroid_abs", "vertices"]
_FULL_TURN = 2 * math.pi
_BENT = 0.01  # metres and share of the longest side by which rounded corners may miss those of a box
_OWN = ("name", "centroid", "dimensions", "rotations", "vertices")
_SIDES = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]] * 2)  # of the length and the width
_SIGNS = np.column_stack([_SIDES, [-1] * 4 + [1] * 4])


def parse_labelcloud(data: bytes, path: Path | str, *, angles: Angles | None = None) -> tuple[CuboidEntry, ...]:
    """The boxes of one file; further texts, numbers and flags of an object are attributes.

    Args:
        data: The file's bytes.
        path: The file, for messages.
        angles: What rotations count where the file does not show it; None refuses such a file.

    Raises:
        FileFormatError: If it is not of this form, or its angles can be either.
    """
    objects = _objects(data, path)
    unit = angles_shown(objects, path) or angles
    if unit is None and any("vertices" not in entry for entry in objects):
        raise FileFormatError(
            path,
            where="rotations",
            expected="radians of centroid_rel (some are negative) or degrees of centroid_abs (some are beyond 6.3)",
            got="angles from 0 to 6.3 alone, which may be either",
            fix="Say which: --label-angles radians or degrees, in Python label_angles=.",
        )
    return tuple(
        CuboidEntry(("objects", number), _cuboid(entry, unit or "radians", path, f"object {number}"))
        for number, entry in enumerate(objects)
    )


def angles_in(data: bytes, path: Path | str) -> Angles | Literal["either"] | None:
    """What the rotations of a file show: None where they can be both, ``"either"`` where all are zero or there is none.

    Raises:
        FileFormatError: If it is not of this form.
    """
    objects = _objects(data, path)
    turned = [entry for entry in objects if "vertices" not in entry and any(_turns(entry))]
    return angles_shown(objects, path) if turned else "either"


def angles_shown(objects: Sequence[Mapping[str, Any]], path: Path | str) -> Angles | None:
    """What the rotations of some objects show; angles of zero are the same in both.

    Raises:
        FileFormatError: If some are negative, as radians are, and others beyond a turn of radians.
    """
    turns = [turn for entry in objects if "vertices" not in entry for turn in _turns(entry)]
    if not any(turns):
        return "radians"
    negative, large = min(turns) < 0, max(turns) > _FULL_TURN
    if negative and large:
        expected = "radians from -pi to pi (centroid_rel) or degrees from 0 to 360 (centroid_abs)"
        raise FileFormatError(path, where="rotations", expected=expected, got=f"{min(turns):g} and {max(turns):g}")
    if negative or large:
        return "radians" if negative else "degrees"
    return "degrees" if max(turns) > math.pi + 1e-6 else None


def _turns(entry: Mapping[str, Any]) -> list[float]:
    rotations = entry.get("rotations")
    values = rotations.values() if isinstance(rotations, dict) else ()
    return [number for value in values if (number := finite(value)) is not None]


def _objects(data: bytes, path: Path | str) -> list[dict[str, Any]]:
    content = parse_json(data, path, max_bytes=MAX_BYTES)
    objects = content.get("objects") if isinstance(content, dict) else None
    if not isinstance(objects, list):
        raise FileFormatError(path, where="the root", expected="an object with a list objects", got=repr(content)[:80])
    for number, entry in enumerate(objects):
        if not isinstance(entry, dict):
            raise FileFormatError(path, where=f"object {number}", expected="an object", got=repr(entry)[:80])
    return objects


def _cuboid(entry: Mapping[str, Any], unit: Angles, path: Path | str, where: str) -> Cuboid:
    if "vertices" in entry:
        centre, size, turn = _of_corners(entry["vertices"], path, where)
    else:
        centre, turn = (xyz(entry.get(name), path, where, name) for name in ("centroid", "rotations"))
        sides = entry.get("dimensions")
        values = [sides.get(name) for name in ("length", "width", "height")] if isinstance(sides, dict) else None
        size = numbers(values, 3, path, where, "dimensions with length, width, height")
        if unit == "degrees":
            turn = _of_degrees(turn, path, where)
        elif abs(turn[2]) > math.pi:
            turn = [*turn[:2], math.remainder(turn[2], _FULL_TURN)]
    return Cuboid(
        label=_class(entry.get("name"), path, where),
        box=checked(centre, size, turn[2], path, where, tilt_rad=turn[:2]),
        attributes={name: value for name, value in attributes_of(entry).items() if name not in _OWN},
    )


def _class(value: Any, path: Path | str, where: str) -> str:
    name = word(value, path, where, "name")
    if not name.strip():
        raise FileFormatError(path, where=where, expected="a text as name", got=repr(value)[:80])
    return name


def _of_degrees(turn: Sequence[float], path: Path | str, where: str) -> list[float]:
    if not all(0 <= angle <= 360 for angle in turn):
        raise FileFormatError(path, where=where, expected="rotations from 0 to 360 degrees", got=repr(list(turn)))
    return [math.radians(angle if angle <= 180 or axis == 2 else angle - 360) for axis, angle in enumerate(turn)]


def _of_corners(value: Any, path: Path | str, where: str) -> tuple[list[float], list[float], list[float]]:
    rows = value if isinstance(value, list) and len(value) == 8 else None
    if rows is None:
        raise FileFormatError(path, where=where, expected="vertices of 8 corners", got=repr(value)[:80])
    corners = np.array([numbers(row, 3, path, where, f"vertices, corner {i}") for i, row in enumerate(rows)])
    centre = corners.mean(axis=0)
    signs = _SIGNS
    halves = signs.T @ (corners - centre) / 8  # half a side from the centre, for length, width and height
    if np.linalg.det(halves) < 0:  # the corners in the other direction, as older files have them: the same box
        signs = _SIGNS * [1, -1, 1]
        halves[1] *= -1
    size = 2 * np.linalg.norm(halves, axis=1)
    misses = np.abs(centre + signs @ halves - corners).max()
    skew = np.abs(halves @ halves.T - np.diag((size / 2) ** 2)).max()
    longest = float(size.max())
    if misses > _BENT * (1 + longest) or skew > _BENT * longest * (1 + longest):
        expected = "the corners of a box: bottom before top, left back, left front, right front, right back"
        raise FileFormatError(path, where=where, expected=expected, got=repr(value)[:120])
    if (size < 1e-9).any():
        return centre.tolist(), size.tolist(), [0.0, 0.0, 0.0]
    length, width, _ = halves / np.linalg.norm(halves, axis=1)[:, None]
    tilt = [math.asin(max(-1.0, min(1.0, float(axis[2])))) for axis in (width, length)]
    if halves[2, 2] < 0:
        tilt[0] = math.pi
    return centre.tolist(), size.tolist(), [*tilt, math.atan2(length[1], length[0])]


def corners_of(cuboid: Cuboid) -> list[list[float]]:
    """The eight corners of a box, in labelCloud's order."""
    x, y, z, length, width, height, yaw = cuboid.box
    cosine, sine = math.cos(yaw), math.sin(yaw)
    halves = np.array([[length * cosine, length * sine, 0], [-width * sine, width * cosine, 0], [0, 0, height]]) / 2
    corners: list[list[float]] = (np.array([x, y, z]) + _SIGNS @ halves).tolist()
    return corners


def form_of(entry: Mapping[str, Any], unit: Angles | None) -> Form:
    """The form of one object of a file whose angles are known."""
    if "vertices" in entry:
        return "vertices"
    return "centroid_abs" if unit == "degrees" else "centroid_rel"


def forms_in(text: str, angles: Angles | None) -> list[Form]:
    """The form of each object of a file, whose rotations count ``angles`` unless that is None."""
    objects = plain_json(text)["objects"]
    unit = angles or angles_shown(objects, "")
    return [form_of(entry, unit) for entry in objects]


def with_unit_shown(text: str, angles: Angles | None) -> str:
    """The text, where its rotations may be of either unit with one of them turned by a full turn, which shows it.

    Args:
        text: A whole file.
        angles: What its rotations count; None leaves it as it is.
    """
    objects = plain_json(text)["objects"]
    turned = [row for row, entry in enumerate(objects) if "vertices" not in entry and any(_turns(entry))]
    if angles is None or not turned or angles_shown(objects, "") == angles:
        return text
    row, rotations = turned[-1], objects[turned[-1]]["rotations"]
    if angles == "degrees":  # about z a turn more would lie beyond 360 degrees; about x 360 is none
        axis = next((axis for axis in "xy" if not rotations.get(axis)), None)
        return text if axis is None else set_value(text, ("objects", row, "rotations", axis), 360.0)
    axis = next(axis for axis in "zyx" if rotations.get(axis))
    return set_value(text, ("objects", row, "rotations", axis), float(rotations[axis]) - _FULL_TURN)


def values(cuboid: Cuboid, form: Form) -> Mapping[tuple[str | int, ...], Any]:
    """What an object says of a cuboid, by the way to it in the object; of the rotations only that about z."""
    x, y, z, length, width, height, yaw = cuboid.box
    changes: dict[tuple[str | int, ...], Any] = {("name",): cuboid.label}
    if form == "vertices":
        return changes | {("vertices",): corners_of(cuboid)}
    turn = math.degrees(yaw) % 360 if form == "centroid_abs" else math.remainder(yaw, _FULL_TURN)
    changes |= {("centroid", axis): value for axis, value in zip("xyz", (x, y, z), strict=True)}
    sizes = {"length": length, "width": width, "height": height}
    return changes | {("dimensions", name): value for name, value in sizes.items()} | {("rotations", "z"): turn}


def entry_of(cuboid: Cuboid, form: Form) -> dict[str, Any]:
    """A whole new object."""
    if form == "vertices":
        return {"name": cuboid.label, "vertices": corners_of(cuboid)} | dict(cuboid.attributes)
    entry: dict[str, Any] = {"name": cuboid.label, "centroid": {}, "dimensions": {}, "rotations": {"x": 0.0, "y": 0.0}}
    for steps, value in values(cuboid, form).items():
        if len(steps) == 2:
            entry[str(steps[0])][steps[1]] = value
    return entry | dict(cuboid.attributes)


def with_new(text: str, cuboid: Cuboid, form: Form) -> str:
    """A file's text with an object more."""
    return append(text, ("objects",), entry_of(cuboid, form))


def format_labelcloud(cuboids: Sequence[Cuboid], cloud: str, *, form: Form = "vertices") -> str:
    """A new file's text.

    Args:
        cuboids: All boxes.
        cloud: Name of the cloud's file.
        form: How boxes are written.
    """
    names = {"folder": "pointclouds", "filename": cloud, "path": f"pointclouds/{cloud}"} if cloud else {}
    return json.dumps(names | {"objects": [entry_of(cuboid, form) for cuboid in cuboids]}, indent=4) + "\n"
