"""Annotations of Cirrus: its JSON, the authors' 15-column text, and the way to :class:`Boxes` and back.

JSON (one file a Gaussian sweep, same stem)::

    {"label_type": "cuboid",
     "labels": [{"label_class": "vehicle", "position": [x, y, z], "size": [l, w, h], "quaternion": [x, y, z, w]}]}

Position is the centre. Farfield's writer adds keys that other readers may ignore: ``track_id``,
``point_count_gaussian``, ``point_count_uniform``, ``full_position`` and ``full_size`` a label; ``world_T_lidar`` and
``conditions`` at the root.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.cirrus.layout import Labels
from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import FARTHEST_M, check_turns, check_yaw, is_name
from farfield.files.json_text import plain_json
from farfield.files.limits import check_name
from farfield.frame import Annotation, Boxes
from farfield.geometry.poses import quaternion_from_yaw, yaw_from_quaternion
from farfield.vocabulary.classes import normalised_class

_MAX_BYTES = 64 << 20
_LARGEST = FARTHEST_M


@dataclass(frozen=True, eq=False, kw_only=True)
class RawLabels:
    """Annotations as the file has them: no order changed, nothing converted.

    Args:
        path: The file.
        classes: Class names as written, one a label.
        position: Three numbers a label, shape (n, 3).
        size: Three numbers a label, shape (n, 3).
        quaternion: Four numbers a label, shape (n, 4).
        extra: The whole label objects, for keys beyond the four.
        root: Keys of the file beside the labels.
    """

    path: Path
    classes: tuple[str, ...]
    position: Float[np.ndarray, "n 3"]
    size: Float[np.ndarray, "n 3"]
    quaternion: Float[np.ndarray, "n 4"]
    extra: Sequence[Mapping[str, Any]] = ()
    root: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.classes)


def read_labels(path: Path, settings: Labels) -> RawLabels:
    """Read one annotation file, JSON or the authors' text by its suffix.

    Raises:
        FileFormatError: If the file does not hold what the settings say.
    """
    return parse_labels(read_bytes(path, max_bytes=_MAX_BYTES), path, settings)


def parse_labels(data: bytes, path: Path, settings: Labels) -> RawLabels:
    """Parse the content of an annotation file, JSON or text by its path's suffix.

    Raises:
        FileFormatError: As :func:`read_labels`.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, where=f"byte {error.start}", expected="UTF-8 text", got="other bytes") from error
    return _parse_text(path, text, settings) if path.suffix.lower() == ".txt" else _parse_json(path, text, settings)


def _parse_json(path: Path, text: str, settings: Labels) -> RawLabels:
    try:
        content = plain_json(text)
    except ValueError as error:
        raise FileFormatError(path, where="the file", expected="JSON", got=plain(error)) from error
    if not isinstance(content, dict) or not isinstance(content.get(settings.root), list):
        raise FileFormatError(
            path,
            where="the root",
            expected=f"an object with a list {settings.root!r}",
            got=f"keys {sorted(content)[:8]}" if isinstance(content, dict) else type(content).__name__,
            fix="Name the list's key in the mapping: labels: {root: ...}.",
        )
    labels = content.pop(settings.root)
    for number, label in enumerate(labels):
        if not isinstance(label, dict) or not is_name(label.get(settings.class_)):
            actual = f"keys {sorted(label)[:12]}" if isinstance(label, dict) else type(label).__name__
            raise FileFormatError(
                path, where=f"label {number}", expected=f"an object with text {settings.class_!r}", got=actual
            )
        check_name(path, f"label {number}", label[settings.class_])
    return RawLabels(
        path=path,
        classes=tuple(label[settings.class_] for label in labels),
        position=_column(path, labels, settings.position, 3),
        size=_column(path, labels, settings.size, 3),
        quaternion=_column(path, labels, settings.quaternion, 4),
        extra=labels,
        root=content,
    )


def _column(path: Path, labels: list[dict[str, Any]], key: str, width: int) -> Float[np.ndarray, "n width"]:
    rows = np.full((len(labels), width), np.nan)
    for number, label in enumerate(labels):
        value = label.get(key)
        if (
            not isinstance(value, list)
            or len(value) != width
            or not all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        ):
            expected = f"{key!r} with {width} numbers"
            raise FileFormatError(path, where=f"label {number}", expected=expected, got=repr(value)[:80])
        rows[number] = [float(x) if abs(x) < _LARGEST else np.nan for x in value]
    if not np.isfinite(rows).all():
        number = int(np.argwhere(~np.isfinite(rows))[0][0])
        raise FileFormatError(
            path,
            where=f"label {number}",
            expected=f"{key!r} finite and below {_LARGEST:g}",
            got=repr(labels[number][key])[:80],
        )
    return rows


def _parse_text(path: Path, text: str, settings: Labels) -> RawLabels:
    """Parse ``type trunc occ alpha x1 y1 x2 y2 h w l x y z yaw``, x y z the bottom centre on the camera's axes.

    The authors' files name the sizes as if the heading lay along the width: their ``w`` is the length, their ``l`` the
    width, and their angle is minus the yaw (modulo pi). Drawn, that is the same rectangle as KITTI's reading, in which
    the angle is minus yaw minus pi / 2 and the names are right; ``text_naming: kitti`` chooses that one.
    """
    rows, classes = [], []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        try:
            digits = "".join(fields[1:])
            values = [float(value) for value in fields[1:]] if digits.isascii() and "_" not in digits else []
        except ValueError:
            values = []
        if len(values) != 14 or not is_name(fields[0]) or not (np.abs(values) < _LARGEST).all():
            expected = "a class and 14 finite numbers"
            raise FileFormatError(path, where=f"line {number}", expected=expected, got=repr(line[:80]))
        check_yaw(values[13], path, f"line {number}")
        rows.append(values[7:])
        classes.append(check_name(path, f"line {number}", fields[0]))
    height, second, third, right, down, ahead, angle = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    authors = settings.text_naming == "authors"
    length, width = (second, third) if authors else (third, second)
    in_order = {"l": length, "w": width, "h": height}
    quaternion = quaternion_from_yaw(-angle if authors else -angle - np.pi / 2)
    up = height / 2 if settings.position_is == "center" else np.zeros_like(height)
    return RawLabels(
        path=path,
        classes=tuple(classes),
        position=np.stack([ahead, -right, -down + up], 1),
        size=np.stack([in_order[letter] for letter in settings.size_order], 1),
        quaternion=quaternion if settings.quat_order == "xyzw" else quaternion[:, [3, 0, 1, 2]],
        extra=[{}] * len(classes),
    )


def boxes_from_labels(raw: RawLabels, settings: Labels, *, full: bool = False) -> Boxes:
    """Convert annotations to boxes in Farfield's convention.

    Args:
        raw: What :func:`read_labels` gave.
        settings: Orders and meanings.
        full: Take ``full_position`` and ``full_size`` instead of the visible part's.

    Raises:
        FileFormatError: If a size is not positive or a quaternion is zero.
    """
    if len(raw) == 0:
        return Boxes.empty()
    position, size = raw.position, raw.size
    if full:
        labels = [dict(label) for label in raw.extra]
        position, size = _column(raw.path, labels, "full_position", 3), _column(raw.path, labels, "full_size", 3)
    size = size[:, [settings.size_order.index(letter) for letter in "lwh"]]
    _require(raw.path, (size > 0).all(axis=1), "a positive size", size)
    if settings.position_is == "bottom":
        position = position + np.stack([0 * size[:, 2], 0 * size[:, 2], size[:, 2] / 2], 1)
    quaternion = raw.quaternion[:, [1, 2, 3, 0]] if settings.quat_order == "wxyz" else raw.quaternion
    check_turns(quaternion, raw.path, "label {}", upright=False)  # the doctor tells their order
    yaw = yaw_from_quaternion(quaternion)
    return Boxes(
        centre_m=position,
        size_m=size,
        yaw_rad=yaw * settings.yaw_scale + np.deg2rad(settings.yaw_offset_deg),
        label=[normalised_class(name, settings.aliases) for name in raw.classes],
        track_id=_tracks(raw),
        point_count=_counts(raw, "point_count_gaussian"),
    )


def annotation_from_labels(raw: RawLabels, settings: Labels) -> Annotation:
    """Convert annotations with all that the file says of each box.

    Args:
        raw: What :func:`read_labels` gave.
        settings: Orders and meanings.

    Raises:
        FileFormatError: As :func:`boxes_from_labels`.
    """
    has_full = len(raw) > 0 and all("full_position" in label and "full_size" in label for label in raw.extra)
    counts = _counts(raw, "point_count_uniform")
    return Annotation(
        boxes=boxes_from_labels(raw, settings),
        original_label=raw.classes,
        extent="visible",
        full_boxes=boxes_from_labels(raw, settings, full=True) if has_full else None,
        details={} if counts is None or (counts < 0).any() else {"point_count_uniform": counts},
    )


def _require(path: Path, good: Any, expected: str, values: Any) -> None:
    if not good.all():
        number = int(np.argmin(good))
        raise FileFormatError(path, where=f"label {number}", expected=expected, got=str(values[number].tolist()))


def _counts(raw: RawLabels, key: str) -> Int[np.ndarray, " n"] | None:
    """Numbers of points under ``key``, -1 where absent, None if absent everywhere."""
    values = [label.get(key) for label in raw.extra]
    for number, value in enumerate(values):
        if value is not None and not (type(value) is int and -1 <= value < 1 << 53):
            raise FileFormatError(
                raw.path, where=f"label {number}", expected=f"a number of points as {key!r}", got=repr(value)[:80]
            )
    if all(value is None for value in values):
        return None
    return np.array([-1 if value is None else value for value in values], dtype=np.int64)


def _tracks(raw: RawLabels) -> Int[np.ndarray, " n"] | None:
    """Tracks, -1 where absent, None if absent everywhere; names become stable numbers."""
    values = [label.get("track_id") for label in raw.extra]
    for number, value in enumerate(values):
        if value is not None and not is_name(value) and not (type(value) is int and -1 <= value < 1 << 63):
            expected = "a whole number from -1 on, or a name, as 'track_id'"
            raise FileFormatError(raw.path, where=f"label {number}", expected=expected, got=repr(value)[:80])
    if all(value is None for value in values):
        return None
    return np.array([_track(value) for value in values], dtype=np.int64)


def _track(value: int | str | None) -> int:
    if value is None:
        return -1
    return int.from_bytes(hashlib.sha256(value.encode()).digest()[:7], "big") if isinstance(value, str) else value
