"""One annotated box as annotation tools exchange it, and the checks that all their formats share."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError
from farfield.files.json_text import finite
from farfield.files.limits import MAX_NAME

Value = str | int | float | bool
_FARTHEST_M, _LEAST_M, _LARGEST_M = 1e5, 1e-4, 1e3
_MOST_YAW, _MOST_TILT = 4 * math.pi, 0.5  # radians
_MOST_NORM_ERROR = 0.1
FARTHEST_M = 1e7
"""No map is larger: a place beyond is none in metres."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cuboid:
    """A box of a frame.

    Args:
        frame: The frame's name in the file; empty where a file holds one frame.
        label: Class as written.
        box: x, y, z of the centre, length, width, height (metres), yaw (radians, counter-clockwise from +x): in the
            cloud's coordinates.
        track: Its identity over time; empty where it has none.
        attributes: What else the file says of it.
    """

    frame: str = ""
    label: str
    box: tuple[float, float, float, float, float, float, float]
    track: str = ""
    attributes: Mapping[str, Value] = field(default_factory=dict)


class CuboidEntry(NamedTuple):
    """A cuboid and the way to it in a JSON file."""

    steps: tuple[str | int, ...]
    cuboid: Cuboid


def numbers(value: Any, count: int, path: Path | str, where: str, name: str) -> list[float]:
    """A list of so many finite numbers.

    Raises:
        FileFormatError: If the value is anything else.
    """
    values = [finite(number) for number in value] if isinstance(value, Sequence) and not isinstance(value, str) else []
    finite_values = [number for number in values if number is not None]
    if len(values) != count or len(finite_values) != count:
        raise FileFormatError(path, where=where, expected=f"{name} of {count} numbers", got=repr(value)[:80])
    return finite_values


def xyz(value: Any, path: Path | str, where: str, name: str) -> list[float]:
    """The numbers of an object ``{"x", "y", "z"}``.

    Raises:
        FileFormatError: If it is anything else.
    """
    values = [value.get(axis) for axis in "xyz"] if isinstance(value, Mapping) else None
    return numbers(values, 3, path, where, f"{name} with x, y, z")


def checked(
    centre_m: Sequence[float],
    size_m: Sequence[float],
    yaw_rad: float,
    path: Path | str,
    where: str,
    *,
    tilt_rad: Sequence[float] = (),
) -> tuple[float, float, float, float, float, float, float]:
    """A box of sensible numbers.

    Args:
        centre_m: x, y, z.
        size_m: Length, width, height.
        yaw_rad: Heading.
        path: The file, for messages.
        where: The place in it.
        tilt_rad: Roll and pitch, which boxes here do not have: those of a slope are left out.

    Raises:
        FileFormatError: If a size is not positive or beyond a kilometre, the place beyond 100 km, the yaw beyond two
            turns, or the box does not stand upright.
    """
    if not all(_LEAST_M <= size <= _LARGEST_M for size in size_m):
        raise FileFormatError(path, where=where, expected="positive sizes in metres", got=repr(list(size_m)))
    if not all(abs(coordinate) <= _FARTHEST_M for coordinate in centre_m):
        raise FileFormatError(path, where=where, expected="a place within 100 km", got=repr(list(centre_m)))
    check_yaw(yaw_rad, path, where)
    if not all(abs(angle) <= _MOST_TILT for angle in tilt_rad):
        expected = f"a box that stands upright: roll and pitch within {_MOST_TILT} rad"
        fix = "Turn it about z alone, and exchange its sizes where it lies on a side."
        raise FileFormatError(path, where=where, expected=expected, got=repr(list(tilt_rad)), fix=fix)
    x, y, z = centre_m
    length, width, height = size_m
    return x, y, z, length, width, height, yaw_rad


def check_yaw(yaw_rad: float, path: Path | str, where: str) -> None:
    """Refuse an angle of degrees: one beyond two turns of radians.

    Raises:
        FileFormatError: If it is one.
    """
    if not abs(yaw_rad) <= _MOST_YAW:
        fix = "Degrees are radians times 57.29578; write radians from -pi to pi."
        raise FileFormatError(path, where=where, expected="a yaw in radians", got=f"{yaw_rad:g}", fix=fix)


def check_turns(
    quaternion_xyzw: Float[np.ndarray, "n 4"], path: Path | str, where: str, *, upright: bool = True
) -> None:
    """Refuse quaternions that are no turn of a box on a road: of another length than 1, or of a box on its side.

    Another order of the four numbers turns upright boxes over, unless they head along x.

    Args:
        quaternion_xyzw: One a box, finite.
        path: The file, for messages.
        where: The place of a box in it, such as ``"label {}"``.
        upright: Whether boxes have to stand upright.

    Raises:
        FileFormatError: If one is such.
    """
    norm = np.linalg.norm(quaternion_xyzw, axis=1)
    for row in np.flatnonzero(np.abs(norm - 1) > _MOST_NORM_ERROR)[:1].tolist():
        actual = repr(quaternion_xyzw[row].tolist())
        raise FileFormatError(path, where=where.format(row), expected="a quaternion of length 1", got=actual)
    up = 1 - 2 * (quaternion_xyzw[:, :2] ** 2).sum(axis=1) / norm**2
    for row in np.flatnonzero(upright & (up < math.cos(_MOST_TILT)))[:1].tolist():
        raise FileFormatError(
            path,
            where=where.format(row),
            expected=f"a box that stands upright: roll and pitch within {_MOST_TILT} rad",
            got=f"the quaternion {quaternion_xyzw[row].tolist()} (x, y, z, w)",
            fix="Its four numbers may stand in another order, with w first or last.",
        )


def is_name(value: Any) -> bool:
    """Whether a value is a text on one line that is not blank, as names of classes and tracks are."""
    return isinstance(value, str) and bool(value.strip()) and value.isprintable()


def word(value: Any, path: Path | str, where: str, name: str) -> str:
    """A text of 1 to 200 characters on one line; a whole number does as well.

    Raises:
        FileFormatError: If it is anything else.
    """
    text = str(value) if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**18 else value
    if not isinstance(text, str) or not 0 < len(text) <= MAX_NAME or not text.isprintable():
        raise FileFormatError(path, where=where, expected=f"a text as {name}", got=repr(value)[:80])
    return text


def wrapped(yaw_rad: float) -> float:
    """A yaw in [-pi, pi), as other tools expect it; one that is there already keeps every bit."""
    if -math.pi <= yaw_rad < math.pi:
        return yaw_rad
    return (yaw_rad + math.pi) % (2 * math.pi) - math.pi


def attributes_of(value: Any) -> dict[str, Value]:
    """Those of an object's entries that are texts, numbers or flags; all others are left out."""
    if not isinstance(value, Mapping):
        return {}
    plain = {str(name): entry for name, entry in value.items() if isinstance(entry, str | bool)}
    counted = {str(name): number for name, entry in value.items() if (number := finite(entry, limit=1e300)) is not None}
    return plain | counted
