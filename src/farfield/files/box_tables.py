"""Boxes as named columns, rows of numbers and CSV files, and the other way; what is returned are fields of a Boxes."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Shaped

from farfield.errors import ConfigError
from farfield.files.boxes_csv import BoxRows, read_boxes_csv, write_boxes_csv

_PLACES, _SIZES, _VELOCITY = ("x", "y", "z"), ("l", "w", "h"), ("vx_m_s", "vy_m_s", "vz_m_s")
_COUNTS = ("track_id", "point_count")
_NEEDED = ("label", *_PLACES, *_SIZES, "yaw_rad")
_KEY = ("sequence", "frame")
_MOST_RAD = 6.3  # a little over a whole turn: beyond it an angle is more likely one in degrees

Fields = dict[str, Any]


@runtime_checkable
class BoxColumns(Protocol):
    """Columns by name: a dictionary, or a DataFrame, which is no Mapping."""

    def keys(self) -> Iterable[Any]:
        """Their names."""

    def __getitem__(self, name: Any, /) -> Any:
        """One of them."""


def columns_of(boxes: Mapping[str, Any]) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The fields of boxes as columns, named as in our CSV files; those that are None are left out."""
    table = {"label": boxes["label"]}
    table |= dict(zip(_PLACES, boxes["centre_m"].T, strict=True)) | dict(zip(_SIZES, boxes["size_m"].T, strict=True))
    table["yaw_rad"] = boxes["yaw_rad"]
    table |= {name: boxes[name] for name in ("score", *_COUNTS) if boxes[name] is not None}
    if boxes["velocity_m_s"] is not None:
        table |= dict(zip(_VELOCITY, boxes["velocity_m_s"].T, strict=False))
    return table


def fields_of(table: BoxColumns) -> Fields:
    """Fields of boxes from a table of named columns: a dictionary, a DataFrame, a structured array's columns.

    Raises:
        ConfigError: If a column is missing, the boxes are those of several frames, or yaw stands in degrees.
    """
    names = [str(name) for name in table.keys()]  # noqa: SIM118 - what has columns need not iterate over them
    missing = [name for name in _NEEDED if name not in names]
    if missing:
        raise ConfigError(
            f"Boxes: expected the columns {', '.join(_NEEDED)}; missing: {', '.join(missing)} of {', '.join(names)}."
        )
    _check_one_frame(
        "Boxes", {name: np.asarray(table[name]) for name in _KEY if name in names}, "select the rows of one frame first"
    )
    numbers = {name: np.asarray(table[name], dtype=np.float64) for name in names if name in _numeric(names)}
    yaw_rad = _radians(numbers["yaw_rad"])
    axes = [name for name in _VELOCITY if name in names]
    fields: Fields = {
        "centre_m": np.stack([numbers[name] for name in _PLACES], axis=1),
        "size_m": np.stack([numbers[name] for name in _SIZES], axis=1),
        "yaw_rad": yaw_rad,
        "label": [str(word) for word in np.asarray(table["label"])],
        "score": numbers.get("score"),
        "velocity_m_s": np.stack([numbers[name] for name in axes], axis=1) if len(axes) > 1 else None,
    }
    score = fields["score"]
    if score is not None and len(score) and np.isnan(score).all():
        fields["score"] = None
    return fields | {name: _whole(numbers[name]) for name in _COUNTS if name in names}


def _numeric(names: list[str]) -> set[str]:
    return {*_NEEDED[1:], "score", *_COUNTS, *_VELOCITY} & {*names}


def _whole(column: Float[np.ndarray, " n"]) -> Shaped[np.ndarray, " n"]:
    """Whole numbers as pandas leaves them where one is missing: -1 there."""
    return np.where(np.isnan(column), -1, column).astype(np.int64)


def _radians(yaw: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    if np.abs(yaw).max(initial=0.0) > _MOST_RAD:
        raise ConfigError(
            f"Boxes: expected yaw in radians, got up to {np.abs(yaw).max():g}; np.radians(...) turns degrees into them"
        )
    return yaw


def rows_of(boxes: Shaped[np.ndarray, "n columns"]) -> Fields:
    """Places, sizes and headings from rows x, y, z, length, width, height, yaw.

    Raises:
        ConfigError: If rows have another length, or yaw stands in degrees.
    """
    rows = np.asarray(boxes, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 7:
        raise ConfigError(f"Boxes: expected shape (n, 7): x, y, z, length, width, height, yaw (rad); got {rows.shape}")
    return {"centre_m": rows[:, :3], "size_m": rows[:, 3:6], "yaw_rad": _radians(rows[:, 6])}


def read_fields(path: Path | str, *, frame: str | None, sequence: str | None) -> Fields:
    """Fields of the boxes of one frame of a CSV file.

    Raises:
        ConfigError: If there are several frames and none is named, or none of that name.
        FileFormatError: If the file is no such file.
    """
    rows = read_boxes_csv(path)
    keep = np.ones(len(rows), dtype=bool)
    for word, wanted, given in (("sequence", sequence, rows.sequence), ("frame", frame, rows.frame)):
        if wanted is None:
            continue
        keep &= False if given is None else given == wanted
        if not keep.any():
            known = [] if given is None else [str(name) for name in np.unique(given)[:8]]
            raise ConfigError(f"{path}: no boxes of the {word} {wanted!r}; there are {', '.join(known) or 'none'}")
    keys = {"frame": rows.frame[keep]} | ({} if rows.sequence is None else {"sequence": rows.sequence[keep]})
    _check_one_frame(str(path), keys, "choose with frame= and sequence=")
    names = ("centre_m", "size_m", "yaw_rad", "label", "score", *_COUNTS, "velocity_m_s")
    return {name: None if getattr(rows, name) is None else getattr(rows, name)[keep] for name in names}


def _check_one_frame(where: str, keys: Mapping[str, Shaped[np.ndarray, " n"]], mend: str) -> None:
    if not keys:
        return
    frames = set(zip(*(map(str, column) for column in keys.values()), strict=True))
    if len(frames) > 1:
        raise ConfigError(f"{where}: expected the boxes of one frame, got {len(frames)}; {mend}")


def write_fields(path: Path | str, boxes: Mapping[str, Any], *, frame: str, sequence: str) -> None:
    """Write boxes as those of one frame."""
    count = len(boxes["yaw_rad"])
    names = {"frame": np.full(count, frame), "sequence": np.full(count, sequence) if sequence else None}
    write_boxes_csv(path, BoxRows(**{**boxes, **names}))
