"""Point clouds with named columns, and their files of any kind.

``farfield convert DATA --to cache`` writes a binary cache, ``<root>/.farfield_cache/<path below root>.ffcloud``, which
is read in its place where it is newer: in a fraction of the time of parsing text. The readers of the formats are
imported when a file of theirs is read.
"""

import tokenize
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Num, Shaped

from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.stand_ins import check_itself
from farfield.geometry.arrays import Locked
from farfield.geometry.boxes import Boxes, points_in_boxes
from farfield.geometry.poses import check_rigid, transform_points
from farfield.registry import display_html

_PLACE = ("x_m", "y_m", "z_m")
RADAR_COLUMNS = ("power", "doppler", "rcs")
"""How the columns begin that a radar's clouds have and a LiDAR's have not."""
CACHE_FOLDER = ".farfield_cache"
CLOUD_SUFFIXES = (".pcd", ".bin", ".npy", ".xyz", ".ffcloud")

_MOST_COLUMNS, _LINE_BYTES = 16, 4096
_NEAREST_M = 1e4  # no sensor sees so far: clouds in millimetres begin nearer


@dataclass(frozen=True, eq=False)
class Cloud(Locked):
    """A point cloud with whatever columns its file had; its arrays are read-only.

    Args:
        points_m: x, y, z in metres from about the sensor, shape (n, 3); kept as float32.
        intensity: Return strength in [0, 1], shape (n,), kept as float32; None where it is not known, and for a radar,
            whose power or cross-section is a column of its own.
        extra: Further columns by name, each of shape (n,): ``ring``, ``time_ns``, ``power``, ``doppler_m_s``...
        missing: Rows of the file that had no place, as organised clouds mark a direction without return; left out.

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
        away_m = _beyond_any_sensor(points_m)
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
        """Read a cloud file: .pcd, .bin, .npy, .xyz or .ffcloud; see :func:`read_cloud`.

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
        LiDAR's cloud that has none, with a warning.

        Raises:
            ConfigError: If the cloud has no such column.
        """
        if name in _PLACE:
            return self.points_m[:, _PLACE.index(name)]
        if name == "intensity" and self.intensity is not None:
            return self.intensity
        if name in self.extra:
            return self.extra[name].astype(np.float32, copy=False)
        if name == "lag_s":
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
        moved = transform_points(target_T_source, self.points_m.astype(np.float64))
        return Cloud(moved, self.intensity, self.extra)

    def in_boxes(self, boxes: Boxes, *, margin_m: float = 0.0) -> list[Int[np.ndarray, " _"]]:
        """Indices of the points inside each box, one array a box."""
        return points_in_boxes(self.points_m, boxes, margin_m=margin_m)


def _beyond_any_sensor(points_m: Num[np.ndarray, "n 3"]) -> float:
    """The distance of the nearest point, metres, where it is beyond what sensors see; 0 where it is not.

    What stands at the origin is no return and does not count.
    """
    if not len(points_m) or max(points_m.max(), -points_m.min()) <= _NEAREST_M:  # not so for NaN: then it is looked at
        return 0.0
    range_m = np.linalg.norm(points_m.astype(np.float64), axis=1)
    range_m = range_m[np.isfinite(range_m) & (range_m > 0)]
    nearest_m = float(range_m.min()) if len(range_m) else 0.0
    return nearest_m if nearest_m > _NEAREST_M else 0.0


def cache_path(source: Path, root: Path) -> Path:
    """Where the cache of a cloud file stands.

    >>> cache_path(Path("d/dataset1_gaussian/1.xyz"), Path("d")).as_posix()
    'd/.farfield_cache/dataset1_gaussian/1.xyz.ffcloud'
    """
    relative = source.relative_to(root)
    return root / CACHE_FOLDER / relative.with_name(relative.name + ".ffcloud")


def is_fresh(cached: Path, source: Path) -> bool:
    """Whether a cache file exists and is not older than its source."""
    return cached.is_file() and cached.stat().st_mtime_ns >= source.stat().st_mtime_ns


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
        if len(good) < 4 or len({len(column) for column in good}) != 1 or len(good) != len(stored):
            actual = f"{', '.join(stored)[:80]}"
            fix = "Delete the cache file, or write it anew: farfield convert DATA --to cache --overwrite."
            raise FileFormatError(cached, where="the columns", expected="c0, c1, c2...", got=actual, fix=fix)
        return good
    return list(read_xyz(source, columns=columns, delimiter=delimiter).T)


def write_rows_cache(source: Path, root: Path, *, columns: int | None = None, delimiter: str = "auto") -> Path:
    """Parse an ASCII cloud and write its cache; returns the cache's path.

    Columns are float32, except where numbers above 100,000 (times, identities) need float64.
    """
    from farfield.files.clouds import write_cache
    from farfield.files.xyz import read_xyz

    rows = read_xyz(source, columns=columns, delimiter=delimiter)
    cached = cache_path(source, root)
    cached.parent.mkdir(parents=True, exist_ok=True)
    write_cache(
        cached,
        {
            f"c{number}": column.astype(np.float32 if np.abs(column).max(initial=0.0) < 1e5 else np.float64)
            for number, column in enumerate(rows.T)
        },
    )
    return cached


def read_cloud(path: Path, *, bin_columns: int | None = None, intensity_scale: float | None = None) -> Cloud:
    """Read one cloud file of a known suffix: .pcd, .bin (velodyne), .npy (rows), .xyz or .ffcloud.

    Args:
        path: The file.
        bin_columns: Columns of ``.bin`` files; None decides by the numbers themselves.
        intensity_scale: Value that stands for full reflectance; None takes the smallest of 1, 255 and 65535 that
            covers the file.

    Raises:
        FileFormatError: If the file is damaged, or an intensity is negative or beyond the scale.
        DatasetError: If the suffix is unknown, x, y and z are missing, or all points lie beyond 10 km.
    """
    from farfield.files.clouds import bin_columns as bin_columns_of
    from farfield.files.clouds import names_of

    if path.suffix == ".pcd":
        from farfield.files.pcd import read_pcd

        return _from_columns(path, read_pcd(path), intensity_scale)
    if path.suffix == ".ffcloud":
        from farfield.files.clouds import read_cache

        return _from_columns(path, read_cache(path), intensity_scale)
    if path.suffix == ".bin":
        from farfield.files.clouds import read_bin

        rows = read_bin(path, columns=bin_columns_of(path).count if bin_columns is None else bin_columns)
    elif path.suffix == ".xyz":
        rows = np.column_stack(read_rows(path, path.parent, columns=xyz_columns(path)))
    elif path.suffix == ".npy":
        rows = _read_npy(path)
    else:
        raise DatasetError(f"{path}: expected a cloud with suffix {', '.join(CLOUD_SUFFIXES)}")
    return _from_columns(path, dict(zip(names_of(rows), rows.T, strict=True)), intensity_scale)


def cloud_of_rows(rows: Shaped[np.ndarray, "n c"]) -> Cloud:
    """A cloud of an array in memory, its columns named as those of a file are.

    Raises:
        ConfigError: If it does not have rows of three numbers or more.
        DatasetError: If coordinates are not finite, or an intensity is negative.
    """
    from farfield.files.clouds import names_of

    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        raise ConfigError(f"expected rows of 3 or more numbers, got shape {rows.shape} of {rows.dtype}")
    return _from_columns(Path("array"), dict(zip(names_of(rows), rows.T, strict=True)), None)


def columns_shown(paths: Sequence[Path]) -> int | None:
    """Columns that the largest of some ``.bin`` files shows, None where it shows none: see ``bin_columns``."""
    from farfield.files.clouds import bin_columns as bin_columns_of

    sizes = [(path.stat().st_size, path) for path in paths if path.suffix == ".bin"]
    if not sizes:
        return None
    _, largest = max(sizes, key=itemgetter(0))
    try:
        columns = bin_columns_of(largest)
    except (FileFormatError, OSError):  # reported when the cloud is read
        return None
    return columns.count if columns.likely else None


def _read_npy(path: Path) -> Shaped[np.ndarray, "n c"]:
    check_itself(path)
    try:
        rows = np.load(path, allow_pickle=False, mmap_mode="r")  # the header's size is checked against the file's
    except (ValueError, OSError, EOFError, SyntaxError, tokenize.TokenError) as error:  # numpy parses a Python literal
        raise DatasetError(f"{path}: expected a .npy file of numbers, found: {error}") from error
    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        raise DatasetError(f"{path}: expected rows of at least 3 numbers, got shape {rows.shape} of {rows.dtype}")
    if rows.shape[1] > _MOST_COLUMNS >= rows.shape[0] >= 3:  # a row a quantity, not a row a point
        rows = rows.T
    return np.array(rows)


def xyz_columns(path: Path) -> int | None:
    """Columns of an ASCII cloud with fewer than Cirrus' five: three, or four; None leaves it to the reader."""
    check_itself(path)
    with path.open("rb") as handle:
        first = handle.read(_LINE_BYTES).partition(b"\n")[0].decode("ascii", errors="replace")
    count = len(first.replace(";", " ").replace(",", " ").split())
    return count if count in (3, 4) else None


def _from_columns(path: Path, columns: Mapping[str, np.ndarray], scale: float | None) -> Cloud:
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise DatasetError(f"{path}: expected columns x, y, z; missing {', '.join(missing)} of {', '.join(columns)}")
    points = np.stack([columns[name] for name in "xyz"], axis=1).astype(np.float32)
    valid = np.isfinite(points).all(axis=1)
    if path.suffix == ".pcd" and not valid.all() and np.isnan(points[~valid]).any(axis=1).all():
        returned = {name: value[valid] for name, value in columns.items()}  # NaN: nothing came back
        return replace(_from_columns(path, returned, scale), missing=int((~valid).sum()))
    if not valid.all():
        row = int(np.argwhere(~np.isfinite(points))[0][0])
        raise DatasetError(f"{path}: expected finite coordinates, got {points[row].tolist()} in point {row}")
    if len(points) and np.hypot(points[:, 0], points[:, 1]).min() > _NEAREST_M:
        raise DatasetError(
            f"{path}: expected metres from the sensor, got points of which the nearest lies "
            f"{np.hypot(points[:, 0], points[:, 1]).min():.4g} away: coordinates of a map (UTM, ECEF)? Subtract where "
            "the sensor stood, in float64."
        )
    strength = np.asarray(columns.get("intensity", np.zeros(len(points))), dtype=np.float32)
    if not np.isfinite(strength).all():
        raise DatasetError(f"{path}: expected finite intensities, got some that are not")
    scale = intensity_scale_of(float(strength.max(initial=0.0))) if scale is None else scale
    if len(strength) and (strength.min() < 0 or strength.max() > scale * (1 + 1e-5)):
        raise FileFormatError(
            path,
            where="the intensity column",
            expected=f"values from 0 to {scale:g}",
            got=f"{strength.min():g} to {strength.max():g}",
            fix="Give the value that stands for full reflectance, such as intensity_scale=255, or fix the column.",
        )
    extra = {name: value for name, value in columns.items() if name not in ("x", "y", "z", "intensity")}
    return Cloud(points, np.clip(strength / np.float32(scale), 0.0, 1.0), extra)


def intensity_scale_of(largest: float) -> float:
    """Value that stands for full reflectance: the smallest of 1, 255 and 65535 that covers the largest intensity."""
    return next((scale for scale in (1.0, 255.0, 65535.0) if largest <= scale * (1 + 1e-6)), largest)
