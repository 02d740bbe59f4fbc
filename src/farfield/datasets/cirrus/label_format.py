"""The JSON annotations of Cirrus, edited value by value."""

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from farfield.datasets.cirrus.labels import boxes_from_labels, parse_labels
from farfield.datasets.cirrus.reader import Cirrus
from farfield.datasets.cirrus.text_labels import render_text
from farfield.datasets.labels.contract import BoxLabel, Value
from farfield.datasets.labels.json_labels import JsonLabels
from farfield.errors import DatasetError
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.json_text import append
from farfield.frame import Key
from farfield.geometry.poses import quaternion_from_yaw

_COUNTS = ("point_count_gaussian", "point_count_uniform", "full_position", "full_size")


class CirrusLabelFormat(JsonLabels):
    """The annotation files of a Cirrus data set, read by its mapping.

    A moved box loses its counts of points and the whole body that Farfield's writer noted beside the visible part. The
    authors' text is edited by :mod:`farfield.datasets.cirrus.text_labels`.

    Args:
        data: The data set as it was opened, without maps.
    """

    name: ClassVar[str] = "cirrus"
    attributes: Mapping[str, tuple[Value, ...]] = {}

    def __init__(self, data: Cirrus) -> None:
        self.data, self.settings = data, data.mapping.labels

    @cached_property
    def _index(self) -> dict[Key, int]:
        return {key: index for index, key in enumerate(self.data.keys)}

    def path(self, key: Key) -> Path:
        """The annotation of a frame, or where it would stand: beside the Gaussian sweep's folder, under its stem."""
        if key not in self._index:
            raise DatasetError(f"{self.data.root}: expected a frame of this data set, got {'/'.join(key)}")
        entry = self.data.entries[self._index[key]]
        if entry.labels is not None:
            return entry.labels
        number = "".join(letter for letter in entry.key.parent.name if letter.isdigit()) or "1"
        return entry.part.root / f"dataset{number}_annotation" / f"{entry.key.stem}.json"

    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All labels of the frame."""
        raw = parse_labels(data, path, self.settings)
        boxes = boxes_from_labels(raw, self.settings)
        rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).tolist()
        return [
            CuboidEntry((self.settings.root, place), Cuboid(label=name, box=tuple(row), track=_track(raw.extra[place])))
            for place, (name, row) in enumerate(zip(raw.classes, rows, strict=True))
        ]

    def empty(self) -> str:
        """A file without labels."""
        return json.dumps({"label_type": "cuboid", self.settings.root: []}, indent=1) + "\n"

    def values(self, cuboid: Cuboid, text: str, place: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """Place, size, quaternion, class and track as the mapping orders them."""
        del text, place
        entry = self._entry(cuboid)
        known: dict[tuple[str | int, ...], Any] = {
            (name, axis): number
            for name, value in entry.items()
            if isinstance(value, list)
            for axis, number in enumerate(value)
        }
        return known | {(name,): value for name, value in entry.items() if not isinstance(value, list)}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other labels in some frames."""
        if path.suffix == ".txt":
            return render_text(data, path, labels, self.settings)
        return super().render(data, path, labels)

    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A label more."""
        return append(text, (self.settings.root,), self._entry(cuboid))

    def stale(self) -> Sequence[tuple[str | int, ...]]:
        """Counts of points, and the whole body."""
        return [(name,) for name in _COUNTS]

    def _entry(self, cuboid: Cuboid) -> dict[str, Any]:
        known = self.settings
        x, y, z, length, width, height, yaw = cuboid.box
        size = {"l": length, "w": width, "h": height}
        angle = (yaw - np.deg2rad(known.yaw_offset_deg)) / known.yaw_scale
        quaternion = quaternion_from_yaw(np.array(angle)).tolist()
        entry: dict[str, Any] = {
            known.class_: cuboid.label,
            known.position: [x, y, z if known.position_is == "center" else z - height / 2],
            known.size: [size[letter] for letter in known.size_order],
            known.quaternion: quaternion if known.quat_order == "xyzw" else [quaternion[3], *quaternion[:3]],
        }
        return entry | ({"track_id": int(cuboid.track)} if cuboid.track.isdecimal() else {})


def _track(label: Mapping[str, Any]) -> str:
    track = label.get("track_id")
    return str(track) if isinstance(track, str | int) and track not in (-1, "") else ""
