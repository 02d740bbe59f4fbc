"""The JSON of mmdetection3d's inferencers: one file a frame, boxes of numbered classes.

Keys (mmdet3d/apis/inferencers/base_3d_inferencer.py, ``pred2dict``): ``labels_3d``, ``scores_3d``, ``bboxes_3d`` and
``box_type_3d``. A ``LiDAR`` box is x, y, z of its bottom's centre, length, width, height, yaw counter-clockwise from
+x, perhaps velocity along x and y; a ``Camera`` box is KITTI's: bottom centre, length, height, width, rotation about y.
The number of a class says nothing without the list that the model was trained on: the files that this package writes
carry it as ``classes``, which the tool passes over, and their coordinates as ``reference``.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import FileFormatError
from farfield.files.atomic import write_text
from farfield.files.cuboids import FARTHEST_M, check_yaw, is_name
from farfield.files.json_text import finite, read_json
from farfield.files.limits import MAX_NAME

BOX_TYPES = ("LiDAR", "Camera")
_MOST_CLASSES, _MOST_BOXES = 10_000, 1 << 20
_LEAST_M, _LARGEST_M = 1e-4, 1e4


@dataclass(frozen=True, eq=False, kw_only=True)
class InstanceBoxes:
    """The boxes of one frame as the file has them.

    Args:
        box: x, y, z of the bottom's centre, three sizes, turn, shape (n, 7): as ``box_type`` says.
        box_type: One of :data:`BOX_TYPES`.
        class_number: Numbers of the classes, from 0, shape (n,).
        score: Shape (n,).
        velocity_m_s: Along x and y, shape (n, 2), or None.
        classes: Names by number; empty where the file has none.
        reference: Coordinates of the boxes; empty where the file does not name them.
    """

    box: Float[np.ndarray, "n 7"]
    box_type: str
    class_number: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    velocity_m_s: Float[np.ndarray, "n 2"] | None = None
    classes: tuple[str, ...] = ()
    reference: str = ""

    def __len__(self) -> int:
        return len(self.score)


def read_instances(path: Path | str) -> InstanceBoxes:
    """Read the file of a frame; the keys may stand under ``pred_instances_3d``.

    Raises:
        FileFormatError: If it is no such JSON: a key is absent, lists differ in length, boxes have other than 7 or 9
            numbers or impossible ones, or the boxes are of a type that no road has.
    """
    tree = read_json(path)
    if not isinstance(tree, dict):
        raise FileFormatError(path, where="the file", expected="a JSON object", got=type(tree).__name__)
    inner = tree.get("pred_instances_3d", tree)
    tree = tree | inner if isinstance(inner, dict) else tree
    box_type = tree.get("box_type_3d")
    if box_type not in BOX_TYPES:
        expected = f"{' or '.join(BOX_TYPES)} (boxes of rooms, Depth, are not read)"
        raise FileFormatError(path, where="box_type_3d", expected=expected, got=repr(box_type)[:40])
    boxes, scores, labels = (_list(path, tree, key) for key in ("bboxes_3d", "scores_3d", "labels_3d"))
    if not len(boxes) == len(scores) == len(labels) or len(boxes) > _MOST_BOXES:
        expected = "bboxes_3d, scores_3d and labels_3d of one length"
        actual = f"{len(boxes)}, {len(scores)} and {len(labels)}"
        raise FileFormatError(path, where="the lists", expected=expected, got=actual)
    widths = {len(box) if isinstance(box, list) else 0 for box in boxes}
    if not widths <= {7} and not widths <= {9}:
        actual = " and ".join(map(str, sorted(widths)))
        raise FileFormatError(path, where="bboxes_3d", expected="7 numbers a box, or 9 of all", got=actual)
    table = np.array([_row(path, row, box) for row, box in enumerate(boxes)], dtype=np.float64)
    table = table.reshape(len(boxes), max(widths, default=7))
    for row, number in enumerate(labels):
        if type(number) is not int or not 0 <= number < _MOST_CLASSES:
            raise FileFormatError(path, where=f"labels_3d[{row}]", expected="a number from 0", got=repr(number)[:40])
    values = [finite(score) for score in scores]
    for row, value in enumerate(values):
        if value is None:
            raise FileFormatError(path, where=f"scores_3d[{row}]", expected="a number", got=repr(scores[row])[:40])
    return InstanceBoxes(
        box=table[:, :7],
        box_type=box_type,
        class_number=np.array(labels, dtype=np.int64),
        score=np.array(values, dtype=np.float64),
        velocity_m_s=table[:, 7:9] if table.shape[1] == 9 else None,
        classes=_classes(path, tree.get("classes")),
        reference=_reference(path, tree.get("reference", "")),
    )


def _list(path: Path | str, tree: Mapping[str, Any], key: str) -> list[Any]:
    value = tree.get(key)
    if not isinstance(value, list):
        raise FileFormatError(path, where=key, expected="a list", got=repr(value)[:40] if key in tree else "nothing")
    return value


def _row(path: Path | str, row: int, box: list[Any]) -> list[float]:
    values = [finite(number, limit=FARTHEST_M) for number in box]
    numbers = [value for value in values if value is not None]
    if len(numbers) != len(box) or not all(_LEAST_M <= size <= _LARGEST_M for size in numbers[3:6]):
        expected = f"finite numbers, sizes from {_LEAST_M:g} to {_LARGEST_M:g} m"
        raise FileFormatError(path, where=f"bboxes_3d[{row}]", expected=expected, got=repr(box)[:80])
    check_yaw(numbers[6], path, f"bboxes_3d[{row}]")
    return numbers


def _classes(path: Path | str, value: Any) -> tuple[str, ...]:
    if value is None:
        return ()
    names = value if isinstance(value, list) else [None]
    if (
        not all(isinstance(name, str) and is_name(name) and len(name) <= MAX_NAME for name in names)
        or len(names) > _MOST_CLASSES
    ):
        raise FileFormatError(path, where="classes", expected="a list of names", got=repr(value)[:60])
    return tuple(names)


def _reference(path: Path | str, value: Any) -> str:
    if value == "" or (is_name(value) and len(value) <= MAX_NAME):
        return str(value)
    raise FileFormatError(path, where="reference", expected="a name of coordinates", got=repr(value)[:60])


def write_instances(path: Path | str, instances: InstanceBoxes) -> None:
    """Write the file of a frame."""
    rows = instances.box
    if instances.velocity_m_s is not None:
        rows = np.column_stack([instances.box, instances.velocity_m_s])
    tree: dict[str, Any] = {
        "labels_3d": instances.class_number.tolist(),
        "scores_3d": instances.score.tolist(),
        "bboxes_3d": np.asarray(rows).tolist(),
        "box_type_3d": instances.box_type,
        "classes": list(instances.classes),
        "reference": instances.reference,
    }
    write_text(Path(path), json.dumps(tree) + "\n")
