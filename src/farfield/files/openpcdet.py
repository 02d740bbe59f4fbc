"""Label files of OpenPCDet's and mmdetection3d's custom sets: a box a line, ``x y z dx dy dz yaw name``.

Both say so in their own pages: OpenPCDet's docs/CUSTOM_DATASET_TUTORIAL.md (a box's centre, by its unified definition)
and mmdetection3d's docs/en/advanced_guides/customize_dataset.md (its LiDAR boxes stand on z, the middle of the bottom).
Sizes are full lengths in metres along the heading, across it and upwards; the yaw is counter-clockwise from +x.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import checked, is_name
from farfield.files.limits import MAX_NAME

MAX_BYTES = 16 << 20
"""Of a label file: some 200,000 boxes."""
MAX_LIST_BYTES = 64 << 20
"""Of a list of frames."""
_COLUMNS = ("x", "y", "z", "dx", "dy", "dz", "yaw")
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)


@dataclass(frozen=True, eq=False)
class LabelRows:
    """The boxes of a file in its order.

    Args:
        numbers: x, y, z, length, width, height, yaw as they stand there, shape (n, 7).
        names: Class of each, length n.
    """

    numbers: Float[np.ndarray, "n 7"]
    names: tuple[str, ...]


def read_label_rows(path: Path | str) -> LabelRows:
    """Read a file of labels; empty lines and lines that begin with # count for nothing, no line at all is no box.

    Raises:
        FileFormatError: If a line is no seven numbers and a name, a number is none, or the box is impossible.
    """
    try:
        text = read_bytes(path, max_bytes=MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, where="the file", expected="text in UTF-8", got=plain(error)) from error
    numbers, names = [], []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells, where = line.split(), f"line {number}"
        if len(cells) != len(_COLUMNS) + 1:
            raise FileFormatError(
                path,
                where=where,
                expected=f"{' '.join(_COLUMNS)} and a class without blanks",
                got=f"{len(cells)} words: {line.strip()[:80]!r}",
                fix="Write _ for the blanks of a class. KITTI's label files are opened in KITTI's folders.",
            )
        values = [_number(cell, name, path, where) for cell, name in zip(cells[:-1], _COLUMNS, strict=True)]
        numbers.append(checked(values[:3], values[3:6], values[6], path, where))
        if not is_name(cells[-1]) or len(cells[-1]) > MAX_NAME or _NUMBER.fullmatch(cells[-1]):
            expected = f"a class of at most {MAX_NAME} characters at the end, not a number"
            raise FileFormatError(path, where=where, expected=expected, got=repr(cells[-1][:80]))
        names.append(cells[-1])
    return LabelRows(np.array(numbers, dtype=np.float64).reshape(-1, len(_COLUMNS)), tuple(names))


def _number(cell: str, name: str, path: Path | str, where: str) -> float:
    if not _NUMBER.fullmatch(cell) or not np.isfinite(float(cell)):
        fix = "Numbers stand with blanks between them, without commas; the class comes last."
        raise FileFormatError(path, where=where, expected=f"a number as {name}", got=repr(cell[:80]), fix=fix)
    return float(cell)


def format_labels(numbers: Float[np.ndarray, "n 7"], names: Sequence[str]) -> str:
    """The text of a label file; numbers with all their digits.

    Raises:
        ValueError: If a name is none that the file can hold: it has a blank, or is a number.
    """
    wrong = next((name for name in names if not is_name(name) or name.split() != [name] or _NUMBER.fullmatch(name)), "")
    if wrong or "" in names:
        raise ValueError(f"expected a class without blanks that is no number, got {wrong!r}")
    rows = zip(numbers.tolist(), names, strict=True)
    return "".join(f"{' '.join(map(repr, row))} {name}\n" for row, name in rows)


def read_frame_list(path: Path | str) -> tuple[str, ...]:
    """Names of frames, one a line, as ``ImageSets/train.txt`` has them.

    Raises:
        FileFormatError: If it is no text, a line holds several words, or a name stands twice.
    """
    try:
        text = read_bytes(path, max_bytes=MAX_LIST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, where="the list", expected="names of frames", got=plain(error)) from error
    names = tuple(line.strip() for line in text.splitlines() if line.strip())
    wrong = next((name for name in names if len(name.split()) > 1 or not is_name(name) or len(name) > MAX_NAME), None)
    if wrong is not None:
        raise FileFormatError(path, where="the list", expected="the name of a frame a line", got=repr(wrong[:80]))
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise FileFormatError(path, where="the list", expected="each frame once", got=f"{twice!r} twice")
    return names
