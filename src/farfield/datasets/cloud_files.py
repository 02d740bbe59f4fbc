"""Read a cloud file of any kind as columns, through the binary cache beside it where that is newer.

``farfield convert DATA --to cache`` writes ``<root>/.farfield_cache/<path below root>.ffcloud``; reading it takes a
fraction of the time of parsing text.
"""

import tokenize
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from farfield.datasets.base import Dataset
from farfield.datasets.drives import Indices
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.bin_columns import bin_columns as bin_columns_of
from farfield.files.bin_columns import names_of
from farfield.files.clouds import CACHE_SUFFIX, read_bin, read_cache, write_cache
from farfield.files.pcd import read_pcd
from farfield.files.xyz import read_xyz
from farfield.frame import Cloud, Frame, Key

CACHE_FOLDER = ".farfield_cache"
CLOUD_SUFFIXES = (".pcd", ".bin", ".npy", ".xyz", CACHE_SUFFIX)

_MOST_COLUMNS, _LINE_BYTES = 16, 4096
_NEAREST_M = 1e4  # no sensor sees so far: clouds in millimetres begin nearer

Columns = Mapping[str, Shaped[np.ndarray, "n *rest"]]


class CloudFiles(Dataset):
    """Single clouds as frames, each read when it is asked for and not kept.

    Args:
        paths: The files; a file's name is its frame's. Where two have one name, their folders are their sequences.
        bin_columns: Numbers a point in ``.bin`` files; None decides by the numbers themselves.

    Raises:
        DatasetError: If a file is named twice, or two cannot be told apart.
    """

    name = "files"
    root = Path()
    stored = False

    def __init__(self, paths: Sequence[Path], *, bin_columns: int | None = None) -> None:
        self.paths, self.bin_columns = tuple(paths), bin_columns
        alone = len({path.stem for path in self.paths}) == len(self.paths)
        keys: tuple[Key, ...] = tuple(
            ("files" if alone else path.resolve().parent.name, path.stem) for path in self.paths
        )
        double = next((key for key, count in Counter(keys).items() if count > 1), None)
        if double is not None:
            same = ", ".join(str(path) for path, key in zip(self.paths, keys, strict=True) if key == double)
            raise DatasetError(f"{same}: expected each cloud once, and names or folders that differ; both are {double}")

        self.sequences = tuple(sequence for sequence, _ in keys)
        self.frame_ids = tuple(frame_id for _, frame_id in keys)

    def frame(self, index: int) -> Frame:
        """Read the cloud of a file."""
        cloud = read_cloud(self.paths[index], bin_columns=self.bin_columns)
        return Frame.of(cloud, sequence=self.sequences[index], frame_id=self.frame_ids[index])

    def drive_indices(self) -> dict[str, Indices]:
        """None: nothing says whether one cloud follows another."""
        return {}

    def files(self, index: int) -> tuple[Path, ...]:
        """The file of a frame."""
        return (self.paths[index],)


def cache_path(source: Path, root: Path) -> Path:
    """Where the cache of a cloud file stands.

    >>> cache_path(Path("d/dataset1_gaussian/1.xyz"), Path("d")).as_posix()
    'd/.farfield_cache/dataset1_gaussian/1.xyz.ffcloud'
    """
    relative = source.relative_to(root)
    return root / CACHE_FOLDER / relative.with_name(relative.name + CACHE_SUFFIX)


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
    cached = cache_path(source, root)
    if is_fresh(cached, source):
        stored = read_cache(cached)
        known = [stored[name] for number in range(len(stored)) if (name := f"c{number}") in stored]
        good = [column for column in known if column.ndim == 1]
        if len(good) < 4 or len({len(column) for column in good}) != 1 or len(good) != len(stored):
            found = f"{', '.join(stored)[:80]}"
            mend = "Delete the cache file, or write it anew: farfield convert DATA --to cache --overwrite."
            raise FileFormatError(cached, where="the columns", expected="c0, c1, c2...", found=found, mend=mend)
        return good
    return list(read_xyz(source, columns=columns, delimiter=delimiter).T)


def write_rows_cache(source: Path, root: Path, *, columns: int | None = None, delimiter: str = "auto") -> Path:
    """Parse an ASCII cloud and write its cache; returns the cache's path.

    Columns are float32, except where numbers above 100,000 (times, identities) need float64.
    """
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
        bin_columns: Numbers a point in ``.bin`` files; None decides by the numbers themselves.
        intensity_scale: Value that stands for full reflectance; None takes the smallest of 1, 255 and 65535 that
            covers the file.

    Raises:
        FileFormatError: If the file is damaged, or an intensity is negative or beyond the scale.
        DatasetError: If the suffix is unknown, x, y and z are missing, or all points lie beyond 10 km.
    """
    if path.suffix == ".pcd":
        return _from_named(path, read_pcd(path), intensity_scale)
    if path.suffix == CACHE_SUFFIX:
        return _from_named(path, read_cache(path), intensity_scale)
    if path.suffix == ".bin":
        rows = read_bin(path, columns=bin_columns_of(path).count if bin_columns is None else bin_columns)
    elif path.suffix == ".xyz":
        rows = np.column_stack(read_rows(path, path.parent, columns=xyz_columns(path)))
    elif path.suffix == ".npy":
        rows = _read_npy(path)
    else:
        raise DatasetError(f"{path}: expected a cloud with suffix {', '.join(CLOUD_SUFFIXES)}")
    return _from_named(path, dict(zip(names_of(rows), rows.T, strict=True)), intensity_scale)


def cloud_of_rows(rows: Shaped[np.ndarray, "n c"]) -> Cloud:
    """A cloud of an array in memory, its columns named as those of a file are.

    Raises:
        ConfigError: If it does not have rows of three numbers or more.
        DatasetError: If coordinates are not finite, or an intensity is negative.
    """
    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        raise ConfigError(f"expected rows of 3 or more numbers, got shape {rows.shape} of {rows.dtype}")
    return _from_named(Path("array"), dict(zip(names_of(rows), rows.T, strict=True)), None)


def columns_shown(paths: Sequence[Path]) -> int | None:
    """Numbers a point that the largest of some ``.bin`` files shows, None where it shows none: see ``bin_columns``."""
    largest = max((path for path in paths if path.suffix == ".bin"), key=_bytes_of, default=None)
    if largest is None:
        return None
    try:
        found = bin_columns_of(largest)
    except (FileFormatError, OSError):  # said by whoever reads the cloud
        return None
    return found.count if found.likely else None


def _bytes_of(path: Path) -> int:
    return path.stat().st_size


def _read_npy(path: Path) -> Shaped[np.ndarray, "n c"]:
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
    with path.open("rb") as handle:
        first = handle.read(_LINE_BYTES).partition(b"\n")[0].decode("ascii", errors="replace")
    found = len(first.replace(";", " ").replace(",", " ").split())
    return found if found in (3, 4) else None


def _from_named(path: Path, columns: Mapping[str, np.ndarray], scale: float | None) -> Cloud:
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise DatasetError(f"{path}: expected columns x, y, z; missing {', '.join(missing)} of {', '.join(columns)}")
    points = np.stack([columns[name] for name in "xyz"], axis=1).astype(np.float32)
    placed = np.isfinite(points).all(axis=1)
    if path.suffix == ".pcd" and not placed.all() and np.isnan(points[~placed]).any(axis=1).all():
        kept = {name: value[placed] for name, value in columns.items()}  # NaN: nothing came back
        return replace(_from_named(path, kept, scale), missing=int((~placed).sum()))
    if not placed.all():
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
            found=f"{strength.min():g} to {strength.max():g}",
            mend="Give the value that stands for full reflectance, such as intensity_scale=255, or mend the column.",
        )
    extra = {name: value for name, value in columns.items() if name not in ("x", "y", "z", "intensity")}
    return Cloud(points, np.clip(strength / np.float32(scale), 0.0, 1.0), extra)


def intensity_scale_of(largest: float) -> float:
    """Value that stands for full reflectance: the smallest of 1, 255 and 65535 that covers the largest intensity."""
    return next((scale for scale in (1.0, 255.0, 65535.0) if largest <= scale * (1 + 1e-6)), largest)
