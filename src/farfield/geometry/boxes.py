"""Oriented 3D boxes: the one type that annotations, predictions and simulated objects share.

Convention (the same everywhere in Farfield): right-handed, x forward, y left, z up, metres; a box is its centre, its
full length (along its own x), width (y) and height (z), and its yaw, counter-clockwise from +x, in [-pi, pi).

Corner order, seen from above with the heading to the right::

    1 ---- 0        4..7 are the same four corners at the top.
    |      | ->
    2 ---- 3
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Num, Shaped

from farfield.files.boxes_csv import columns_of, fields_of, read_fields, rows_of, write_fields
from farfield.files.limits import MAX_NAME
from farfield.files.tables import columns_in, table_of
from farfield.geometry.arrays import Locked
from farfield.geometry.poses import check_rigid
from farfield.registry import display_html

_CORNER_SIGNS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=np.float64) / 2.0


def wrap_angle_rad(angle_rad: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Wrap angles to [-pi, pi)."""
    angle_rad = np.asarray(angle_rad, dtype=np.float64)
    wrapped = np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi
    wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)  # mod may round up to the period itself
    return np.where((angle_rad >= -np.pi) & (angle_rad < np.pi), angle_rad, wrapped)  # those keep every bit


def _alike(
    velocities_m_s: Sequence[Float[np.ndarray, "_ _"] | None], parts: Sequence["Boxes"]
) -> list[Float[np.ndarray, "_ axes"]] | list[None]:
    """Velocities of parts with equally many axes, NaN for parts that have none; None for all where no part has any."""
    widths = [velocity.shape[1] for velocity in velocities_m_s if velocity is not None]
    if not widths:
        return [None] * len(parts)
    axes = min(widths)
    return [
        np.full((len(part), axes), np.nan) if velocity is None else velocity[:, :axes]
        for part, velocity in zip(parts, velocities_m_s, strict=True)
    ]


@dataclass(frozen=True, eq=False, kw_only=True)
class Boxes(Locked):
    """A set of n oriented 3D boxes with labels and, where known, scores, track ids and point counts.

    Its arrays are read-only; :meth:`replace` gives boxes with others.

    Args:
        centre_m: Box centres x, y, z in metres, shape (n, 3).
        size_m: Full length, width, height in metres, all positive, shape (n, 3).
        yaw_rad: Heading, counter-clockwise from +x, shape (n,). Wrapped to [-pi, pi).
        label: Class names, shape (n,). One string stands for all boxes.
        score: Detection scores, shape (n,), or None for annotations.
        track_id: Identity over time, shape (n,), or None; -1 marks a box without one.
        point_count: Number of LiDAR points inside, shape (n,), or None; -1 marks an unknown count.
        velocity_m_s: Velocity over ground in the boxes' coordinates, x, y and perhaps z, shape (n, 2) or (n, 3), or
            None; NaN in any of its numbers marks a box whose velocity is not known.

    Raises:
        ValueError: If shapes disagree, values are not finite (but NaN velocities) or a size is not positive.
    """

    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    label: Shaped[np.ndarray, " n"] | Sequence[str] | str = "unknown"
    score: Float[np.ndarray, " n"] | None = None
    track_id: Int[np.ndarray, " n"] | None = None
    point_count: Int[np.ndarray, " n"] | None = None
    velocity_m_s: Float[np.ndarray, "n axes"] | None = None

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.yaw_rad))
        self._store("centre_m", self.centre_m, np.float64, (n, 3))
        self._store("size_m", self.size_m, np.float64, (n, 3))
        self._store("yaw_rad", self.yaw_rad, np.float64, (n,))
        object.__setattr__(self, "yaw_rad", wrap_angle_rad(self.yaw_rad))
        label = [self.label] * n if isinstance(self.label, str) else self.label
        is_narrow = isinstance(label, np.ndarray) and label.dtype.kind == "U" and label.dtype.itemsize <= 4 * MAX_NAME
        longest = 0 if is_narrow else max((len(str(name)) for name in label), default=0)
        if longest > MAX_NAME:  # the array would have this width in every row
            raise ValueError(f"Boxes.label: expected names of at most {MAX_NAME} characters, got one of {longest}")
        self._store("label", np.asarray(label, dtype=np.str_) if n else np.empty(0, "<U1"), np.str_, (n,))
        for name, dtype in (("score", np.float64), ("track_id", np.int64), ("point_count", np.int64)):
            if getattr(self, name) is not None:
                self._store(name, getattr(self, name), dtype, (n,))
        if self.velocity_m_s is not None:
            axes = np.shape(self.velocity_m_s)[-1] if np.ndim(self.velocity_m_s) == 2 else 2
            self._store("velocity_m_s", self.velocity_m_s, np.float64, (n, 3 if axes == 3 else 2), nan=True)
        if n and not (self.size_m > 0).all():
            row = int(np.argwhere(~(self.size_m > 0))[0][0])
            raise ValueError(f"Boxes.size_m: expected positive sizes, got {self.size_m[row]} in row {row}")
        self.lock()

    def _store(self, name: str, value: Any, dtype: Any, shape: tuple[int, ...], *, nan: bool = False) -> None:
        values = np.asarray(value)
        if values.shape != shape:
            raise ValueError(f"Boxes.{name}: expected shape {shape}, got {values.shape}")
        if dtype is np.int64 and values.size and values.dtype.kind not in "iu":
            raise ValueError(f"Boxes.{name}: expected whole numbers, got dtype {values.dtype}")
        array = values.astype(dtype, copy=False)
        if array.dtype.kind == "f" and not (valid := np.isfinite(array) | (nan & np.isnan(array))).all():
            row = int(np.argwhere(~valid)[0][0])
            kind = "finite numbers or NaN" if nan else "finite numbers"
            raise ValueError(f"Boxes.{name}: expected {kind}, got {array[row]} in row {row}")
        object.__setattr__(self, name, array)

    @classmethod
    def empty(cls, *, scored: bool = False) -> "Boxes":
        """Return a set without boxes; ``scored`` gives it an (empty) score array, as predictions have."""
        none = np.zeros((0, 3))
        return cls(centre_m=none, size_m=none, yaw_rad=np.zeros(0), label=[], score=np.zeros(0) if scored else None)

    @classmethod
    def concatenate(cls, parts: Sequence["Boxes"]) -> "Boxes":
        """Join several sets in order. An optional field must be present in all non-empty parts or in none.

        Velocities are the exception, as NaN says what is not known: parts that lack them get NaN, and where one part
        knows x and y alone, z is left out of all.

        Raises:
            ValueError: If some parts carry a field that others lack.
        """
        filled = [part for part in parts if len(part)]
        if not filled:
            return parts[0] if parts else cls.empty()
        joined: dict[str, Any] = {}
        for field in fields(cls):
            columns = [getattr(part, field.name) for part in filled]
            values: list[Any] = list(_alike(columns, filled)) if field.name == "velocity_m_s" else columns
            missing = [value is None for value in values]
            if any(missing) and not all(missing):
                raise ValueError(f"Boxes.concatenate: {field.name} is present in some parts and absent in others")
            joined[field.name] = None if all(missing) else np.concatenate(values)
        return cls(**joined)

    def __len__(self) -> int:
        return len(self.yaw_rad)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Float[np.ndarray, "n 7"]:
        """What ``np.asarray(boxes)`` gives: the rows of :meth:`to_numpy`."""
        del copy
        return self.to_numpy() if dtype is None else self.to_numpy().astype(dtype)

    def __add__(self, other: object) -> "Boxes":
        """Both sets as one, see :meth:`concatenate`."""
        return Boxes.concatenate([self, other]) if isinstance(other, Boxes) else NotImplemented

    def __radd__(self, other: object) -> "Boxes":
        """So that ``sum`` of a list of sets joins them."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __getitem__(
        self, index: int | slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"] | Sequence[int]
    ) -> "Boxes":
        """Select boxes by slice, mask or indices. An integer gives a set of one."""
        if isinstance(index, int | np.integer):
            index = np.array([index])
        elif not isinstance(index, slice):
            index = np.asarray(index)
            index = index.astype(np.intp) if index.size == 0 and index.dtype != bool else index
        chosen: dict[str, Any] = {}
        for field in fields(self):
            values = getattr(self, field.name)
            chosen[field.name] = None if values is None else values[index]
        return Boxes(**chosen)

    def __repr__(self) -> str:
        names, counts = np.unique(self.label, return_counts=True)
        inside = ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))
        return f"Boxes({len(self)}: {inside})" if len(self) else "Boxes(0)"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the boxes from above, and a table of the first."""
        return display_html("boxes", self)

    @classmethod
    def from_csv(cls, path: Path | str, *, frame: str | None = None, sequence: str | None = None) -> "Boxes":
        """The boxes of one frame of a CSV file, as ``farfield predict`` writes it; velocities and ids with them.

        Args:
            path: The file.
            frame: Which frame, where the file holds several.
            sequence: Of which sequence.

        Raises:
            ConfigError: If the file holds several such frames, or none.
            FileFormatError: If it is damaged.
        """
        return cls(**read_fields(path, frame=frame, sequence=sequence))

    def to_csv(self, path: Path | str, *, frame: str = "0", sequence: str = "") -> None:
        """Write the boxes as those of one frame of a CSV file, which ``farfield score`` reads.

        Args:
            path: The file.
            frame: Name of the frame.
            sequence: Name of its sequence; no such column where it is empty.
        """
        write_fields(path, vars(self), frame=frame, sequence=sequence)

    def columns(self) -> dict[str, Shaped[np.ndarray, " n"]]:
        """The boxes as columns by name, those of a CSV file: what any library of tables takes."""
        return columns_of(vars(self))

    @classmethod
    def from_numpy(
        cls,
        rows: Num[np.ndarray, "n columns"],
        *,
        label: Shaped[np.ndarray, " n"] | Sequence[str] | str = "unknown",
        score: Float[np.ndarray, " n"] | None = None,
    ) -> "Boxes":
        """Boxes of rows x, y, z, length, width, height in metres and yaw in radians, shape (n, 7).

        Raises:
            ConfigError: If rows have another length, or yaw stands in degrees.
        """
        return cls(**rows_of(rows), label=label, score=score)

    def to_numpy(self) -> Float[np.ndarray, "n 7"]:
        """x, y, z, length, width, height and yaw of each box, shape (n, 7)."""
        return np.column_stack([self.centre_m, self.size_m, self.yaw_rad])

    @classmethod
    def from_pandas(cls, table: Any) -> "Boxes":
        """Boxes of a DataFrame of pandas or polars, or of anything with named columns: those of a CSV file.

        Args:
            table: The rows of one frame: label, x, y, z, l, w, h, yaw_rad, and perhaps score, track_id, point_count,
                vx_m_s, vy_m_s and vz_m_s; others are not looked at.

        Raises:
            ConfigError: If a column is missing, rows are those of several frames, or yaw stands in degrees.
        """
        columns = columns_in(table)
        return cls(**fields_of(table if columns is None else columns))

    def to_pandas(self) -> Any:
        """The boxes as a DataFrame, a row a box.

        Raises:
            ConfigError: If pandas is not installed.
        """
        return table_of(self.columns(), "pandas", "Boxes.to_pandas")

    def to_polars(self) -> Any:
        """The boxes as a DataFrame of polars, a row a box.

        Raises:
            ConfigError: If polars is not installed.
        """
        return table_of(self.columns(), "polars", "Boxes.to_polars")

    def replace(self, **changes: Any) -> "Boxes":
        """Return a copy with the named fields replaced."""
        return replace(self, **changes)

    def plain(self) -> "Boxes":
        """Return places, sizes, headings and labels alone, as boxes of different origin can be joined."""
        return replace(self, score=None, track_id=None, point_count=None, velocity_m_s=None)

    def relabel(self, mapping: Mapping[str, str]) -> "Boxes":
        """Return a copy with class names replaced; names that the mapping lacks stay."""
        return self.replace(label=[mapping.get(str(name), str(name)) for name in self.label])

    @property
    def range_m(self) -> Float[np.ndarray, " n"]:
        """Distance of the centres from the origin in the x-y plane, shape (n,), metres."""
        return np.hypot(self.centre_m[:, 0], self.centre_m[:, 1])

    @property
    def volume_m3(self) -> Float[np.ndarray, " n"]:
        """Volumes, shape (n,), cubic metres."""
        return np.prod(self.size_m, axis=1)

    def bev_corners_m(self) -> Float[np.ndarray, "n 4 2"]:
        """Corners in the x-y plane, shape (n, 4, 2), counter-clockwise from front left."""
        local = _CORNER_SIGNS[None] * self.size_m[:, None, :2]
        cos, sin = np.cos(self.yaw_rad)[:, None], np.sin(self.yaw_rad)[:, None]
        turned = np.stack([local[..., 0] * cos - local[..., 1] * sin, local[..., 0] * sin + local[..., 1] * cos], -1)
        return turned + self.centre_m[:, None, :2]

    def corners_m(self) -> Float[np.ndarray, "n 8 3"]:
        """All eight corners, shape (n, 8, 3): the four of the bottom, then the four of the top."""
        bev = np.concatenate([self.bev_corners_m()] * 2, axis=1)
        half = self.size_m[:, 2] / 2
        z = np.stack([self.centre_m[:, 2] - half] * 4 + [self.centre_m[:, 2] + half] * 4, axis=1)
        return np.concatenate([bev, z[..., None]], axis=2)

    def transform(self, target_T_source: Float[np.ndarray, "4 4"]) -> "Boxes":
        """Move the boxes rigidly: from the source frame into the target frame.

        The heading is the target's yaw of the moved x axis; roll and pitch of the pose move the centres only, because
        a box has none. Velocities turn with the boxes; of a velocity without z what leaves the x-y plane is lost.

        Raises:
            ConfigError: If it is no rigid motion.
        """
        check_rigid(target_T_source, "Boxes.transform")
        rotation = np.asarray(target_T_source, dtype=np.float64)[:3, :3]
        heading = np.stack([np.cos(self.yaw_rad), np.sin(self.yaw_rad), np.zeros(len(self))], 1) @ rotation.T
        centre = self.centre_m @ rotation.T + np.asarray(target_T_source)[:3, 3]
        velocity = self.velocity_m_s
        if velocity is not None:
            velocity = velocity @ rotation[: velocity.shape[1], : velocity.shape[1]].T
        return self.replace(centre_m=centre, yaw_rad=np.arctan2(heading[:, 1], heading[:, 0]), velocity_m_s=velocity)


# Points and boxes: which points lie inside which box.

BOX_MARGIN_M = 0.05
"""By how much boxes grow where points are counted: annotators leave little room, and range noise takes some."""


def box_coordinates_m(points_m: Float[np.ndarray, "n 3"], boxes: Boxes, index: int) -> Float[np.ndarray, "n 3"]:
    """Express points in the frame of box ``index``: origin at its centre, x along its heading; shape (n, 3)."""
    offset = points_m.astype(np.float64) - boxes.centre_m[index]
    cos, sin = np.cos(boxes.yaw_rad[index]), np.sin(boxes.yaw_rad[index])
    return np.stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]], axis=1
    )


def inside_box(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, index: int, *, margin_m: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Whether each point lies in box ``index`` or on its surface, shape (n,)."""
    return (np.abs(box_coordinates_m(points_m, boxes, index)) <= boxes.size_m[index] / 2 + margin_m).all(axis=1)


def points_in_boxes(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, *, margin_m: float = 0.0
) -> list[Int[np.ndarray, " _"]]:
    """Indices of the points inside each box, surface included.

    Args:
        points_m: Points x, y, z, shape (n, 3).
        boxes: m boxes.
        margin_m: Grow each face outwards by this much.

    Returns:
        One sorted index array a box. A point may be in several boxes.
    """
    x, y = np.ascontiguousarray(points_m[:, 0]), points_m[:, 1]
    radius_m = np.hypot(*(boxes.size_m[:, :2].T / 2 + margin_m)) * (1 + 1e-6) + 1e-3  # also covers float32 rounding
    rows = []
    for index, (centre_x, centre_y) in enumerate(boxes.centre_m[:, :2]):
        near = np.flatnonzero(np.abs(x - centre_x) <= radius_m[index])  # cheap, and leaves few
        near = near[np.abs(y[near] - centre_y) <= radius_m[index]]
        rows.append(near[inside_box(points_m[near], boxes, index, margin_m=margin_m)])
    return rows


def count_points_in_boxes(
    points_m: Float[np.ndarray, "n 3"], boxes: Boxes, *, margin_m: float = 0.0
) -> Int[np.ndarray, " m"]:
    """Number of points inside each box, surface included, shape (m,)."""
    inside = points_in_boxes(points_m, boxes, margin_m=margin_m)
    return np.array([len(indices) for indices in inside], dtype=np.int64)
