"""KITTI's object labels, edited line by line; boxes go through the calibration into the lidar's frame and back."""

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from farfield.datasets.kitti.boxes import boxes_in_axes, objects_from_boxes, sized_camera
from farfield.datasets.kitti.object import Kitti
from farfield.datasets.labels.formats import BoxLabel, Numbers, Value
from farfield.datasets.labels.line_labels import FileSpan, kept_numbers, physical_lines, replaced
from farfield.errors import ConfigError, DatasetError
from farfield.files.kitti import KittiObjects, parse_labels, read_calib
from farfield.files.remote_paths import as_path
from farfield.frame import Boxes, Camera, Key
from farfield.vocabulary.classes import CIRRUS_FROM_KITTI, KITTI_FROM_CIRRUS

_FIRST = 8  # columns before h w l x y z rotation_y: type, truncation, occlusion, alpha and the 2D box
_OCCLUSION = (0.0, 1.0, 2.0, 3.0, -1.0)


class KittiLabelFormat:
    """``label_2/NNNNNN.txt`` of a KITTI data set.

    ``DontCare`` and all lines without a 3D box stay as they are. A moved box gets a new 2D box, truncation and
    observation angle from the calibration; its other columns keep their spelling where they did not change.

    Args:
        data: The data set as it was opened, without maps.
    """

    name: ClassVar[str] = "kitti"
    attributes: Mapping[str, tuple[Value, ...]] = {"occlusion": _OCCLUSION}

    def __init__(self, data: Kitti) -> None:
        self.data = data

    @cached_property
    def _index(self) -> dict[Key, int]:
        return {key: index for index, key in enumerate(self.data.keys)}

    def path(self, key: Key) -> Path:
        """The label file of a frame, or where it would stand."""
        if key not in self._index:
            raise DatasetError(f"{self.data.root}: expected a frame of this data set, got {'/'.join(key)}")
        return self.data.folder / "label_2" / f"{key[1]}.txt"

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Objects with a 3D box, in the file's order. The frame's calibration is read.

        Raises:
            FileFormatError: If the file is damaged.
            DatasetError: If the frame has no calibration.
        """
        parts = {key: _parts(data, path, key, self._camera(key)) for key in keys}
        return {key: tuple(part.label for part in held if part.label is not None) for key, held in parts.items()}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other objects; see :class:`~farfield.datasets.labels.formats.LabelFormat`."""
        if not labels:
            return data or b""
        (key,) = labels
        camera = self._camera(key)
        parts = _parts(data or b"", path, key, camera)
        scored = any(len(part.raw.split()) == _FIRST + 8 for part in parts)
        return replaced(parts, labels, write=partial(_written, camera=camera, scored=scored, path=path), same=_same)

    def _camera(self, key: Key) -> Camera:
        calib = self.data.folder / "calib" / f"{key[1]}.txt"
        if not calib.is_file():
            raise DatasetError(f"{calib}: expected a calibration: KITTI's boxes stand in the camera's frame")
        image = next((path for path in self.data.files(self._index[key]) if path.parent.name == "image_2"), None)
        return sized_camera(read_calib(calib), image)


def label_format(data: Kitti) -> KittiLabelFormat | None:
    """The label files of a data set, to edit them; None where they do not stand in the camera's axes."""
    return KittiLabelFormat(data) if data.label_axes == "camera" else None


def _parts(data: bytes, path: Path, key: Key, camera: Camera) -> list[FileSpan]:
    objects = parse_labels(data, path)
    boxes = boxes_in_axes(objects, camera.camera_T_lidar, "camera", as_path(path), classes="kitti")
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).tolist()
    boxed = objects[objects.has_box]
    by_line = {int(line): index for index, line in enumerate(boxed.line)}
    parts = []
    for number, raw in enumerate(physical_lines(data), start=1):
        index = by_line.get(number)
        parts.append(FileSpan(raw) if index is None else FileSpan(raw, key, _label(boxed, index, rows[index])))
    return parts


def _label(boxed: KittiObjects, index: int, row: Sequence[float]) -> BoxLabel:
    x, y, z, length, width, height, yaw = row
    return BoxLabel(
        id=str(index),
        label=str(boxed.type[index]),
        box=(x, y, z, length, width, height, yaw),
        attributes={"occlusion": float(boxed.occlusion[index])},
        score=None if boxed.score is None else float(boxed.score[index]),
    )


def _class(label: str) -> str:
    return KITTI_FROM_CIRRUS.get(label, label)


def _same(old: BoxLabel, new: BoxLabel) -> bool:
    box = kept_numbers(old.box, new.box) == old.box
    return box and _class(old.label) == _class(new.label) and _occlusion(old, old) == _occlusion(new, old)


def _occlusion(label: BoxLabel, otherwise: BoxLabel | None) -> Value:
    return label.attributes.get("occlusion", 3.0 if otherwise is None else otherwise.attributes["occlusion"])


def _written(key: Key, new: BoxLabel, old: FileSpan | None, *, camera: Camera, scored: bool, path: Path) -> bytes:
    """One line; columns whose value did not change stay as they are spelt."""
    del key
    before = None if old is None else old.label
    name, occlusion = _class(new.label), _occlusion(new, before)
    is_kitti = name in CIRRUS_FROM_KITTI or name in KITTI_FROM_CIRRUS.values()
    if not is_kitti and (before is None or name != before.label):
        raise ConfigError(f"{path}: expected a class of KITTI ({', '.join(CIRRUS_FROM_KITTI)}), got {new.label!r}")
    if occlusion not in _OCCLUSION:
        raise ConfigError(f"{path}: expected occlusion 0, 1, 2, 3 or -1 of a {new.label}, got {occlusion!r}")
    new_columns = _columns(new.box, camera) if before is None else _columns(kept_numbers(before.box, new.box), camera)
    cells = [b""] * len(new_columns) if old is None else old.raw.split()[1:]
    standing = new_columns if before is None else _columns(before.box, camera)
    columns = [
        repr(number).encode() if before is None or number != standing[column] else cells[column]
        for column, number in enumerate(new_columns)
    ]
    if before is None or occlusion != before.attributes["occlusion"]:
        columns[1] = b"%d" % int(occlusion)
    elif old is not None:
        columns[1] = cells[1]
    first = name.encode() if before is None or name != _class(before.label) else before.label.encode()
    score = cells[len(new_columns) :] or ([repr(float(new.score or 0.0)).encode()] if scored else [])
    end = b"\n" if old is None or old.raw.endswith(b"\n") else b""
    end = b"\r\n" if old is not None and old.raw.endswith(b"\r\n") else end
    return b" ".join([first, *columns, *score]) + end


def _columns(box: Numbers, camera: Camera) -> list[float]:
    """Truncation, occlusion (not known), alpha, 2D box, h w l, x y z of the bottom, rotation_y."""
    row = np.array([box])
    boxes = Boxes(centre_m=row[:, :3], size_m=row[:, 3:6], yaw_rad=row[:, 6], label="Car")
    objects = objects_from_boxes(boxes, camera, classes={})
    parts = [
        objects.truncation,
        objects.occlusion,
        objects.alpha_rad,
        *objects.box_px.T,
        *objects.size_m.T,
        *objects.bottom_m.T,
    ]
    return [float(part[0]) for part in (*parts, objects.rotation_y_rad)]
