"""Argoverse 2's tables of cuboids: submissions of detections, and annotations with the log beside.

Columns (argoverse/av2-api, MIT, ``av2/evaluation/detection/eval.py``): ``log_id`` (text), ``timestamp_ns`` (int64),
``category`` (text), ``tx_m ty_m tz_m`` (centre), ``length_m width_m height_m``, ``qw qx qy qz``, in the coordinates of
the ego vehicle; detections have ``score``, annotations ``num_interior_pts``. Feather files (Arrow IPC, version 2).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Shaped

from farfield.errors import FileFormatError, MissingExtraError
from farfield.files.atomic import open_atomic
from farfield.files.cuboids import FARTHEST_M, check_turns
from farfield.files.feather import feather_names, read_feather
from farfield.files.limits import check_name
from farfield.files.remote_paths import as_path

_CENTRE, _SIZE = ("tx_m", "ty_m", "tz_m"), ("length_m", "width_m", "height_m")
_TURN = ("qx", "qy", "qz", "qw")
_LARGEST_M = 1e3


@dataclass(frozen=True, eq=False, kw_only=True)
class Argoverse2Boxes:
    """Cuboids, a row each in the order of the file.

    Args:
        log: Name of the log, n texts.
        time_ns: Stamp of the sweep, nanoseconds, shape (n,).
        category: Categories, n texts.
        centre_m: Centres in the ego vehicle's coordinates, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        yaw_rad: Headings, shape (n,).
        score: Scores, None where the table has none, shape (n,).
        points: Points inside, None where the table has none, shape (n,).
    """

    log: Shaped[np.ndarray, " n"]
    time_ns: Int[np.ndarray, " n"]
    category: Shaped[np.ndarray, " n"]
    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    score: Float[np.ndarray, " n"] | None = None
    points: Int[np.ndarray, " n"] | None = None

    def __len__(self) -> int:
        return len(self.log)


def read_argoverse2_boxes(path: Path | str) -> Argoverse2Boxes:
    """Read a table of detections or annotations.

    Raises:
        MissingExtraError: If pyarrow is not installed.
        FileFormatError: If the file is no such table, or a cuboid is impossible or lies on its side.
    """
    path = as_path(path)
    present = set(feather_names(path))
    needed = ("log_id", "timestamp_ns", "category", *_CENTRE, *_SIZE, *_TURN)
    lacking = [name for name in needed if name not in present]
    if lacking:
        fix = "A log's own annotations lack log_id: name the data set's folder in their place." * ("log_id" in lacking)
        expected = f"the columns {', '.join(needed)}"
        raise FileFormatError(path, where="the header", expected=expected, got=f"none of {', '.join(lacking)}", fix=fix)
    beside = [name for name in ("score", "num_interior_pts") if name in present]
    table = read_feather(path, (*needed, *beside))
    for name in (*_CENTRE, *_SIZE, *_TURN, *beside):
        values = table[name]
        wrong = values.dtype.kind not in "fiu" or not (np.abs(values.astype(np.float64)) <= FARTHEST_M).all()
        if wrong and (name != "num_interior_pts" or values.dtype.kind not in "iu"):
            row = "" if values.dtype.kind not in "fiu" else f", such as {values[np.abs(values) > FARTHEST_M][:1]}"
            raise FileFormatError(
                path, where=f"column {name}", expected=f"finite numbers to {FARTHEST_M:g}", got=f"others{row}"
            )
    time_ns = table["timestamp_ns"]
    if time_ns.dtype.kind not in "iu" or (time_ns < 0).any():
        raise FileFormatError(path, where="column timestamp_ns", expected="nanoseconds, from 0 on", got="others")
    for name in ("log_id", "category"):
        if any(not isinstance(text, str) for text in table[name][:1]):
            raise FileFormatError(path, where=f"column {name}", expected="texts", got=str(table[name].dtype))
        for text in np.unique(table[name].astype(np.str_)).tolist():
            check_name(path, f"column {name}", text)
    size_m = np.column_stack([table[name] for name in _SIZE]).astype(np.float64)
    for row in np.flatnonzero(~((size_m > 0) & (size_m < _LARGEST_M)).all(axis=1))[:1].tolist():
        expected = f"length, width, height above 0 and below {_LARGEST_M:g} m"
        raise FileFormatError(path, where=f"row {row}", expected=expected, got=str(size_m[row].tolist()))
    turn = np.column_stack([table[name] for name in _TURN]).astype(np.float64)
    check_turns(turn, path, "row {}")
    x, y, z, w = turn.T
    points = table.get("num_interior_pts")
    if points is not None and (points.dtype.kind not in "iu" or (points < 0).any()):
        raise FileFormatError(path, where="column num_interior_pts", expected="counts from 0 on", got="others")
    return Argoverse2Boxes(
        log=table["log_id"].astype(np.str_),
        time_ns=time_ns.astype(np.int64),
        category=table["category"].astype(np.str_),
        centre_m=np.column_stack([table[name] for name in _CENTRE]).astype(np.float64),
        size_m=size_m,
        yaw_rad=np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z),
        score=None if "score" not in table else table["score"].astype(np.float64),
        points=None if points is None else points.astype(np.int64),
    )


def write_argoverse2_boxes(path: Path | str, parts: Iterable[Argoverse2Boxes]) -> int:
    """Write a table, part after part; returns the number of rows.

    Args:
        path: The file; it appears whole or not at all.
        parts: Cuboids with scores, such as those of one sweep after another.

    Raises:
        MissingExtraError: If pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.ipc
    except ImportError as error:
        raise MissingExtraError("pyarrow", "argoverse2", "Writing Argoverse 2's submissions") from error
    numbers = (*_CENTRE, *_SIZE, "qw", "qx", "qy", "qz", "score")
    schema = pyarrow.schema(
        [
            *((name, pyarrow.float64()) for name in numbers),
            ("log_id", pyarrow.string()),
            ("timestamp_ns", pyarrow.int64()),
            ("category", pyarrow.string()),
        ]
    )
    count = 0
    with open_atomic(path) as handle, pyarrow.ipc.new_file(handle, schema) as writer:
        for part in parts:
            half, zero = part.yaw_rad / 2, np.zeros(len(part))
            score = np.ones(len(part)) if part.score is None else part.score
            columns = [*part.centre_m.T, *part.size_m.T, np.cos(half), zero, zero, np.sin(half), score]
            arrays = [pyarrow.array(np.ascontiguousarray(column, dtype=np.float64)) for column in columns]
            arrays += [
                pyarrow.array(part.log.tolist(), pyarrow.string()),
                pyarrow.array(part.time_ns),
                pyarrow.array(part.category.tolist(), pyarrow.string()),
            ]
            writer.write_batch(pyarrow.record_batch(arrays, schema=schema))
            count += len(part)
    return count
