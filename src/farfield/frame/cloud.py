"""Point clouds with named columns, and their files of any kind.

``farfield convert DATA --to cache`` writes a binary cache, ``<root>/.farfield_cache/<path below root>.ffcloud``, which
is read in its place where it was made of the very bytes: in a fraction of the time of parsing text. The readers of the
formats are imported on first use.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import itemgetter
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Num, Shaped

from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.intensities import intensity_scale_of, scaled_intensity
from farfield.files.map_coordinates import MAP_SUFFIXES, Origin, beyond_any_sensor, read_map_cloud
from farfield.files.marks import mark_of
from farfield.files.npy import read_npy
from farfield.files.point_times import OFFSET_COLUMN, PointTimeColumn, PointTimes, point_time_column
from farfield.frame.cloud_columns import Columns, RowNames, named_columns, points_of, returned
from farfield.geometry.arrays import Locked
from farfield.geometry.boxes import Boxes, points_in_boxes
from farfield.geometry.poses import check_rigid, transform_points
from farfield.registry import display_html

_PLACE = ("x_m", "y_m", "z_m")
RADAR_COLUMNS = ("power", "doppler", "rcs")
"""How the columns begin that a radar's clouds have and a LiDAR's have not."""
CACHE_FOLDER = ".farfield_cache"
CLOUD_SUFFIXES = (".pcd", ".bin", ".npy", ".npz", ".xyz", ".ply", ".las", ".laz", ".ffcloud")

_GPS_TIME = "gps_time"
_MOST_COLUMNS, _MOST_OFFSET_S = 16, 2.0


@dataclass(frozen=True, eq=False)
class Cloud(Locked):
    """A point cloud with whatever columns its file had; its arrays are read-only.

    Args:
        points_m: x, y, z in metres from about the sensor, shape (n, 3); kept as float32.
        intensity: Return strength in [0, 1], shape (n,), kept as float32; None where it is not known, and for a radar,
            whose power or cross-section is a column of its own.
        extra: Further columns by name, each of shape (n,): ``ring``, ``time_ns``, ``power``, ``doppler_m_s``...
        missing: Rows of the file without a place (NaN, or 0, 0, 0), as sensors mark directions without return; they
            are left out.

    Raises:
        ValueError: If columns differ in length, points have no three numbers, all of them lie beyond 10 km (those of
            a map, which float32 holds to half a metre) or an intensity lies outside [0, 1].
    """

    points_m: Num[np.ndarray, "n 3"]
    intensity: Num[np.ndarray, " n"] | None = None
    extra: Mapping[str, Shaped[np.ndarray, " n"]] = field(default_factory=dict)
    missing: int = 0

    def __post_init__(self) -> None:
        points_m = np.asarray(self.points_m)
        object.__setattr__(self, "points_m", points_m.astype(np.float32, copy=False))
        if self.points_m.ndim != 2 or self.points_m.shape[1] != 3:
            raise ValueError(
                f"Cloud.points_m: expected shape (n, 3), got {self.points_m.shape}; Cloud.of takes rows of more columns"
            )
        away_m = beyond_any_sensor(points_m)
        if away_m:
            raise ValueError(
                f"Cloud.points_m: expected metres from the sensor, got points of which the nearest lies "
                f"{away_m:.4g} m away: "
                "coordinates of a map (UTM, ECEF)? float32 holds them to "
                f"{np.spacing(np.float32(np.abs(points_m).max())):.2g} m. Subtract where the sensor stood, in float64."
            )
        if self.intensity is not None:
            object.__setattr__(self, "intensity", np.asarray(self.intensity, dtype=np.float32))
        columns = [*self.extra.values(), *([] if self.intensity is None else [self.intensity])]
        if any(len(column) != len(self.points_m) for column in columns):
            raise ValueError(f"Cloud: expected columns of equal length, got {len(self.points_m)} points")
        if self.intensity is not None and not ((self.intensity >= 0) & (self.intensity <= 1)).all():
            raise ValueError(
                f"Cloud: expected intensities in [0, 1], got {self.intensity.min():g} to {self.intensity.max():g}; "
                "scale them, or give a radar's power as a column of extra"
            )
        self.lock()

    @classmethod
    def of(cls, rows: Shaped[np.ndarray, "n columns"]) -> "Cloud":
        """A cloud of an array, its columns taken as those of a file: x, y, z, then intensity, then what they show.

        Intensities up to 255 or 65535 are brought to [0, 1]; where there are but three columns they are 0.

        Args:
            rows: Shape (n, 3) or wider.

        Raises:
            ConfigError: If the array has another shape.
            DatasetError: If coordinates are not finite.
        """
        return cloud_of_rows(np.asarray(rows))

    @classmethod
    def from_file(cls, path: Path | str) -> "Cloud":
        """Read a cloud file of one of :data:`CLOUD_SUFFIXES`; see :func:`read_cloud`.

        Raises:
            FarfieldError: If there is no such file, its suffix is unknown or it is damaged.
        """
        if not Path(path).is_file():
            raise DatasetError(f"{path}: expected a cloud file, found none there")
        return read_cloud(Path(path))

    @property
    def kind(self) -> Literal["lidar", "radar"]:
        """A radar's if it has a radar's columns and no intensity, else a LiDAR's."""
        of_radar = any(name.startswith(RADAR_COLUMNS) for name in self.extra)
        return "radar" if of_radar and self.intensity is None else "lidar"

    def __len__(self) -> int:
        return len(self.points_m)

    def __repr__(self) -> str:
        range_m = np.hypot(self.points_m[:, 0], self.points_m[:, 1])
        extent = f" to {range_m[np.isfinite(range_m)].max(initial=0.0):.0f} m" if len(self) else ""
        return f"Cloud({len(self):,} points{extent}; {', '.join(self.columns)})"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the cloud from above."""
        return display_html("cloud", self)

    def __getitem__(self, index: slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "Cloud":
        intensity = None if self.intensity is None else self.intensity[index]
        return Cloud(self.points_m[index], intensity, {k: v[index] for k, v in self.extra.items()})

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that :meth:`column` gives."""
        return (*_PLACE, *(() if self.intensity is None else ("intensity",)), *self.extra)

    def column(self, name: str) -> Float32[np.ndarray, " n"]:
        """One column as float32, shape (n,): ``x_m``, ``y_m``, ``z_m``, ``intensity`` or one of ``extra``.

        ``lag_s``, the age of a point's sweep, is zero where the cloud does not have it; so is the intensity of a
        LiDAR's cloud that has none, with a warning. An absent ``sweep`` (before the present one) is 1 for old points.

        Raises:
            ConfigError: If the cloud has no such column.
        """
        if name in _PLACE:
            return self.points_m[:, _PLACE.index(name)]
        if name == "intensity" and self.intensity is not None:
            return self.intensity
        if name in self.extra:
            return self.extra[name].astype(np.float32, copy=False)
        if name == "sweep" and "lag_s" in self.extra and OFFSET_COLUMN not in self.extra:
            return ((self.extra["lag_s"] != 0) & bool((self.extra["lag_s"] == 0).any())).astype(np.float32)
        if name in ("lag_s", "sweep"):
            return np.zeros(len(self), dtype=np.float32)
        if name == "intensity" and self.kind == "lidar":
            warnings.warn(
                "The cloud has no intensity: it is read as 0. A detector that learnt with intensities finds less so; "
                "Cloud(points_m, intensity) gives them.",
                stacklevel=2,
            )
            return np.zeros(len(self), dtype=np.float32)
        raise ConfigError(
            f"Expected a cloud with the column {name!r}; it has {', '.join(self.columns)}. Take a detector that does "
            "not read it, or data that have it."
        )

    def offsets_s(self) -> Float[np.ndarray, " n"] | None:
        """When each point was measured, in seconds since the frame's time, shape (n,); None where it is not known.

        Raises:
            ConfigError: If a column of times holds anything but nanoseconds within a second or so of the frame's time.
        """
        name = next((name for name in (OFFSET_COLUMN, "time_ns") if name in self.extra), None)
        if name is None:
            return None
        offsets_s = np.asarray(self.extra[name], dtype=np.float64) * 1e-9
        if not (np.abs(offsets_s) <= _MOST_OFFSET_S).all():
            raise ConfigError(
                f"Cloud: expected points measured within {_MOST_OFFSET_S:g} s of their sweep, in nanoseconds in the "
                f"column {name}; got {np.min(self.extra[name])} to {np.max(self.extra[name])}. Subtract the frame's "
                "time, or give the unit: --point-times s, ms, us, ns or none (point_times=); odometry takes points as "
                "they are with --no-deskew"
            )
        return offsets_s

    @classmethod
    def concatenate(cls, parts: "list[Cloud]") -> "Cloud":
        """Join clouds; only the columns that all of them have are kept."""
        shared = set.intersection(*(set(part.extra) for part in parts)) if parts else set()
        strengths = [part.intensity for part in parts if part.intensity is not None]
        return cls(
            np.concatenate([part.points_m for part in parts]),
            np.concatenate(strengths) if len(strengths) == len(parts) else None,
            {name: np.concatenate([part.extra[name] for part in parts]) for name in sorted(shared)},
        )

    def transform(self, target_T_source: Float[np.ndarray, "4 4"]) -> "Cloud":
        """Move all points rigidly into another frame.

        Raises:
            ConfigError: If it is no rigid motion.
            ValueError: If the points then lie beyond 10 km, as on a map.
        """
        check_rigid(target_T_source, "Cloud.transform")
        moved = transform_points(target_T_source, self.points_m.astype(np.float64)).astype(np.float32)
        return Cloud(moved, self.intensity, self.extra, self.missing)

    def in_boxes(self, boxes: Boxes, *, margin_m: float = 0.0) -> list[Int[np.ndarray, " _"]]:
        """Indices of the points inside each box, one array a box."""
        return points_in_boxes(self.points_m, boxes, margin_m=margin_m)


def cache_path(source: Path, root: Path) -> Path:
    """Where the cache of a cloud file stands.

    >>> cache_path(Path("d/dataset1_gaussian/1.xyz"), Path("d")).as_posix()
    'd/.farfield_cache/dataset1_gaussian/1.xyz.ffcloud'
    """
    relative = source.relative_to(root)
    return root / CACHE_FOLDER / relative.with_name(relative.name + ".ffcloud")


def is_fresh(cached: Path, source: Path) -> bool:
    """Whether a cache file was made of the bytes that its source has now, by number and CRC-32, whatever the times."""
    from farfield.files.clouds import cache_source

    state = cache_source(cached)
    now = source.stat()
    return state is not None and state[0] == now.st_size and state == _mark(source, now.st_ctime_ns, now.st_ino)


@lru_cache(maxsize=1 << 16)
def _mark(source: Path, changed_ns: int, inode: int) -> tuple[int, int]:  # noqa: ARG001 - what another file differs in
    return mark_of(source)


def read_rows(
    source: Path, root: Path, *, columns: int | None = None, delimiter: str = "auto"
) -> list[Shaped[np.ndarray, " n"]]:
    """Columns of an ASCII cloud, from its cache if that is fresh.

    Args:
        source: The ``.xyz`` file.
        root: Folder that holds the cache folder.
        columns: Number of columns, None for 5 or 8.
        delimiter: As for :func:`farfield.files.xyz.read_xyz`.

    Returns:
        One array a column.

    Raises:
        FileFormatError: If the file is damaged.
    """
    from farfield.files.clouds import read_cache
    from farfield.files.xyz import read_xyz

    cached = cache_path(source, root)
    if is_fresh(cached, source):
        stored = read_cache(cached)
        columns_read = [stored[name] for number in range(len(stored)) if (name := f"c{number}") in stored]
        good = [column for column in columns_read if column.ndim == 1]
        if len(good) < 3 or len({len(column) for column in good}) != 1 or len(good) != len(stored):
            fix = "Delete the cache file, or write it anew: farfield convert DATA --to cache --overwrite."
            raise FileFormatError(
                cached, where="the columns", expected="c0, c1, c2...", got=", ".join(stored)[:80], fix=fix
            )
        return good
    return list(read_xyz(source, columns=columns, delimiter=delimiter, on_nan="keep").T)


def write_rows_cache(source: Path, root: Path, *, columns: int | None = None, delimiter: str = "auto") -> Path:
    """Parse an ASCII cloud and write its cache; returns the cache's path.

    Rows that are NaN, where nothing returned, stay. Columns are float32, except where numbers above 100,000 (times,
    identities) need float64.
    """
    from farfield.files.clouds import write_cache
    from farfield.files.xyz import read_xyz

    state = mark_of(source)  # before the rows: what is changed meanwhile makes the cache stale, not wrong
    rows = read_xyz(source, columns=columns, delimiter=delimiter, on_nan="keep")
    cached = cache_path(source, root)
    cached.parent.mkdir(parents=True, exist_ok=True)
    arrays = {
        f"c{number}": column.astype(np.float32 if np.nanmax(np.abs(column), initial=0.0) < 1e5 else np.float64)
        for number, column in enumerate(rows.T)
    }
    write_cache(cached, arrays, source=state)
    return cached


@dataclass(frozen=True, kw_only=True)
class CloudSettings:
    """How the columns of a cloud file become a cloud.

    Args:
        intensity_scale: Value that stands for full reflectance; None decides by the file, see
            :func:`intensity_scale_of`.
        point_times: Unit of the points' times, see :data:`~farfield.files.point_times.PointTimes`.
        usual_unit: Unit that other clouds of the data set show.
        row_names: Names of the columns of files without any, by how many they are, or those of all; None decides by
            the file.
        stamp_ns: The sweep's time since 1970; None where it is not known.
        period_ns: From one sweep to the next; None where it is not known.
        origin_m: What is subtracted, in float64, from the coordinates of the formats of :data:`MAP_SUFFIXES`; None
            takes the middle of the file's own points where they lie beyond 10 km, and warns.
    """

    intensity_scale: float | int | None = None
    point_times: PointTimes = "auto"
    usual_unit: str | None = None
    row_names: RowNames = None
    stamp_ns: int | None = None
    period_ns: float | int | None = None
    origin_m: Origin | None = None

    def at(self, stamp_ns: int | None) -> "CloudSettings":
        """The same for a sweep of a time."""
        return replace(self, stamp_ns=stamp_ns)


_OWN_SETTINGS = CloudSettings()


def read_cloud(path: Path, settings: CloudSettings = _OWN_SETTINGS, *, bin_columns: int | None = None) -> Cloud:
    """Read one cloud file of one of :data:`CLOUD_SUFFIXES`; ``.bin`` is KITTI's velodyne format.

    Args:
        path: The file.
        settings: How its columns become a cloud.
        bin_columns: Columns of ``.bin`` files; None decides by the numbers themselves.

    Raises:
        FileFormatError: If the file is damaged, an intensity is negative or beyond the scale, or the points' times
            cannot be told.
        DatasetError: If the suffix is unknown, x, y and z are missing, or all points lie beyond 10 km.
    """
    read = read_columns(path, bin_columns=bin_columns, origin_m=settings.origin_m)
    return _from_columns(path, named_columns(path, read, settings.row_names), settings)


def read_columns(
    path: Path, *, bin_columns: int | None = None, origin_m: Origin | None = None
) -> Columns | Shaped[np.ndarray, "n c"]:
    """The columns of a cloud file by the names that it has for them, or its rows where it has none.

    Args:
        path: The file.
        bin_columns: Columns of ``.bin`` files; None decides by the numbers themselves.
        origin_m: As :class:`CloudSettings` has it.

    Raises:
        FileFormatError: If the file is damaged.
        DatasetError: If the suffix is unknown.
    """
    from farfield.files.clouds import bin_columns as bin_columns_of

    suffix = path.suffix.lower()
    if suffix == ".pcd":
        from farfield.files.pcd import read_pcd

        return read_pcd(path)
    if suffix == ".ffcloud":
        from farfield.files.clouds import read_cache

        return read_cache(path)
    if suffix == ".bin":
        from farfield.files.clouds import read_bin

        count = bin_columns_of(path).count if bin_columns is None else bin_columns
        return read_bin(path, columns=count, on_nan="keep")
    if suffix == ".xyz":
        from farfield.files.xyz import xyz_columns

        return np.column_stack(read_rows(path, path.parent, columns=xyz_columns(path)))
    if suffix == ".npz":
        from farfield.files.npz import read_npz

        return read_npz(path)
    if suffix == ".ply":
        from farfield.files.ply import read_ply

        return read_ply(path)
    if suffix in MAP_SUFFIXES:
        return read_map_cloud(path, origin_m)
    if suffix == ".npy":
        rows = _read_npy(path)
        return rows if rows.dtype.names is None else {name: native(rows[name]) for name in rows.dtype.names}
    raise DatasetError(f"{path}: expected a cloud with suffix {', '.join(CLOUD_SUFFIXES)}")


def native(values: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Numbers in this machine's order of bytes, one after another in memory."""
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))


def read_radar_rows(path: Path, columns: int) -> tuple[Float32[np.ndarray, "n columns"], int]:
    """The points of a radar's ``.bin`` file and how many of its rows are none: see :func:`returned`.

    Raises:
        FileFormatError: If the file is damaged, or a number of a point is not finite.
    """
    from farfield.files.clouds import read_bin

    rows = read_bin(path, columns=columns, on_nan="keep")
    points = points_of(path, rows)
    if not np.isfinite(points).all():
        row, column = np.argwhere(~np.isfinite(points))[0]
        raise FileFormatError(
            path,
            where=f"column {column + 1} of point {row}",
            expected="finite numbers",
            got=f"{points[row, column]}",
            fix="The file is damaged: fetch it again, or leave the frame out.",
        )
    return points, len(rows) - len(points)


def cloud_of_rows(rows: Shaped[np.ndarray, "n c"]) -> Cloud:
    """A cloud of an array in memory, its columns named as those of a file are.

    Raises:
        ConfigError: If it does not have rows of three numbers or more.
        DatasetError: If coordinates are not finite, or an intensity is negative.
    """
    from farfield.files.clouds import names_of

    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        raise ConfigError(f"expected rows of 3 or more numbers, got shape {rows.shape} of {rows.dtype}")
    if not np.isfinite(rows[:, :3]).all():
        row = int(np.argwhere(~np.isfinite(rows[:, :3]))[0][0])
        raise DatasetError(f"array: expected finite coordinates, got {rows[row, :3].tolist()} in point {row}")
    return _from_columns(Path("array"), dict(zip(names_of(rows), rows.T, strict=True)))


def columns_shown(paths: Sequence[Path]) -> int | None:
    """Columns that the largest of some ``.bin`` files shows, None where it shows none: see ``bin_columns``."""
    from farfield.files.clouds import bin_columns as bin_columns_of

    sizes = [(path.stat().st_size, path) for path in paths if path.suffix.lower() == ".bin"]
    if not sizes:
        return None
    _, largest = max(sizes, key=itemgetter(0))
    try:
        columns = bin_columns_of(largest)
    except (FileFormatError, OSError):  # reported when the cloud is read
        return None
    return columns.count if columns.likely else None


def _read_npy(path: Path) -> Shaped[np.ndarray, "..."]:
    rows = read_npy(path, fields=True)
    if rows.dtype.names is not None:  # fields by name, one row a point or organised in rows and columns
        return rows.reshape(-1)
    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        raise DatasetError(f"{path}: expected rows of at least 3 numbers, got shape {rows.shape} of {rows.dtype}")
    if rows.shape[1] > _MOST_COLUMNS >= rows.shape[0] >= 3:  # a row a quantity, not a row a point
        rows = rows.T
    return rows


def _from_columns(path: Path, columns: Mapping[str, np.ndarray], settings: CloudSettings = _OWN_SETTINGS) -> Cloud:
    lacking = [name for name in "xyz" if name not in columns]
    if lacking:
        raise DatasetError(f"{path}: expected columns x, y, z; missing {', '.join(lacking)} of {', '.join(columns)}")
    points = np.empty((len(columns["x"]), 3), dtype=np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinite, and refused
        for axis, name in enumerate("xyz"):
            points[:, axis] = columns[name]
    valid = returned(path, points)
    if not valid.all():
        rest = {name: value[valid] for name, value in columns.items()}
        return replace(_from_columns(path, rest, settings), missing=int((~valid).sum()))
    strength = np.asarray(columns.get("intensity", np.zeros(len(points), dtype=np.float32)))
    scale = intensity_scale_of([strength]) if settings.intensity_scale is None else settings.intensity_scale
    extra = {name: value for name, value in columns.items() if name not in ("x", "y", "z", "intensity")}
    return Cloud(points, scaled_intensity(path, strength, scale), with_offsets(path, extra, settings))


def with_offsets(
    path: Path | str, extra: Mapping[str, Shaped[np.ndarray, " n"]], settings: CloudSettings
) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Further columns with the points' times, if there are any, as ``offset_ns``: int64 nanoseconds since the stamp.

    Raises:
        FileFormatError: If their unit or what they count from cannot be told.
    """
    name = None if settings.point_times == "none" else point_time_column(extra)
    if name is None and settings.point_times not in ("none", "auto") and _GPS_TIME in extra:
        name = _GPS_TIME
    if name is None:
        return dict(extra)
    unit = None if settings.point_times == "auto" else settings.point_times
    times = PointTimeColumn(
        name, extra[name], path, settings.stamp_ns, settings.period_ns, usual_unit=settings.usual_unit
    )
    if unit is None and not times.are_times():
        return dict(extra)
    return {key: column for key, column in extra.items() if key != name} | {OFFSET_COLUMN: times.offsets_ns(unit)}
