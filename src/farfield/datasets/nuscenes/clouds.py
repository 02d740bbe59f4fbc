"""Clouds of the nuScenes schema: the files of LiDARs and radars, each brought to the sample's time and coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int64, Shaped

from farfield.datasets.nuscenes.dialects import Dialect, TableFolder
from farfield.datasets.nuscenes.presence import check_there
from farfield.errors import DatasetError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.intensities import scaled_intensity
from farfield.files.json_text import read_json
from farfield.files.limits import MAX_RINGS
from farfield.files.pcd import read_pcd
from farfield.frame import Cloud
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import transform_points

FULL_INTENSITY = 255.0
_RADAR_FIELDS = ("x", "y", "z", "rcs")
_MOST_LAG_S = 10.0
_MOST_COLUMNS = 64


@dataclass(frozen=True, eq=False, kw_only=True)
class SweepFile:
    """One file of a LiDAR or radar.

    Args:
        path: The file.
        info: A JSON file that says how many columns it has; None where there is none.
        folder: Where the data set stands.
        time_us: When it was measured.
        frame_T_sensor: Where the sensor stood then, seen from the frame, shape (4, 4).
    """

    path: Path
    info: Path | None
    folder: TableFolder
    time_us: int
    frame_T_sensor: Float[np.ndarray, "4 4"]


def load_cloud(
    files: Sequence[SweepFile], modality: str, dialect: Dialect, time_us: int, intensity_scale: float | None
) -> Cloud:
    """The points of some files of one sensor, one after another, each moved by its own pose; ``sweep`` numbers them.

    Args:
        files: The key frame's first, then those before it.
        modality: ``"lidar"`` or ``"radar"``.
        dialect: What files hold.
        time_us: The frame's time; ``lag_s`` is how long before it a point was measured.
        intensity_scale: Value that stands for full reflectance in PCD files of LiDARs.

    Raises:
        DatasetError: If one of them is not there.
        FileFormatError: If one of them is damaged.
    """
    for file in files:
        for path in (file.path, *([] if file.info is None else [file.info])):
            check_there(path, file.folder)
    read = _radar if modality == "radar" else _lidar
    parts = [read(file, dialect, time_us, intensity_scale) for file in files]
    if len(parts) == 1:
        return parts[0]
    number = np.repeat(np.arange(len(parts), dtype=np.int16), [len(part) for part in parts])
    joined = Cloud.concatenate(parts)
    return Cloud(joined.points_m, joined.intensity, {**joined.extra, "sweep": number}, joined.missing)


def _lidar(file: SweepFile, dialect: Dialect, time_us: int, intensity_scale: float | None) -> Cloud:
    columns = _pcd_columns(file.path) if file.path.suffix.lower() == ".pcd" else _bin_columns(file, dialect)
    if "intensity" not in columns:
        raise FileFormatError(
            file.path, where="the columns", expected="x, y, z and intensity", got=", ".join(columns)[:80]
        )
    scale = FULL_INTENSITY if file.path.suffix.lower() != ".pcd" or intensity_scale is None else intensity_scale
    strength = columns.pop("intensity")
    points_m, valid = _points(file, columns)
    extra = _lagged(file, columns, time_us, valid)
    intensity = scaled_intensity(file.path, strength[valid], scale)
    moved = transform_points(file.frame_T_sensor, points_m).astype(np.float32)
    return Cloud(moved, intensity, extra, int((~valid).sum()))


def _pcd_columns(path: Path) -> dict[str, np.ndarray]:
    columns = read_pcd(path, spare_bytes=1)
    missing = [axis for axis in "xyz" if axis not in columns]
    odd = [name for name, values in columns.items() if values.ndim != 1]
    if missing or odd:
        got = ", ".join(columns)[:80]
        raise FileFormatError(path, where="FIELDS", expected="x, y, z, one number a point each", got=got)
    return columns


def is_of_four_columns(file: SweepFile, dialect: Dialect) -> bool:
    """Whether a LiDAR's ``.bin`` has four columns by its numbers, where the schema says more and nothing says how many.

    Raises:
        DatasetError: If it has neither.
    """
    return dialect.undecided_columns and _bin_rows(file, dialect)[0].shape[1] == 4 and file.info is None


def _bin_rows(file: SweepFile, dialect: Dialect) -> tuple[Float[np.ndarray, "n c"], bool]:
    """The rows of a ``.bin``, and whether a file beside it says how many columns there are."""
    data = read_bytes(file.path)
    count, is_stated = _column_count(file, dialect)
    rows = _rows(data, count)
    if dialect.undecided_columns and not is_stated and (rows is None or not _has_rings(rows)):
        four = _rows(data, 4)
        if four is not None and _has_intensities(four):
            rows = four
    if rows is None:
        raise FileFormatError(
            file.path, where="the file", expected=f"points of {count} float32 numbers", got=f"{len(data)} bytes"
        )
    return rows, is_stated


def _bin_columns(file: SweepFile, dialect: Dialect) -> dict[str, np.ndarray]:
    rows, is_stated = _bin_rows(file, dialect)
    columns = {name: rows[:, number] for number, name in enumerate(("x", "y", "z", "intensity"))}
    if rows.shape[1] > 4 and not is_stated:
        if not _has_rings(rows):
            raise FileFormatError(
                file.path,
                where="column 5",
                expected=f"rings: whole numbers from -1 to {MAX_RINGS - 1}",
                got=f"others, such as {rows[~_are_rings(rows[:, 4])][0, 4]:g}: points of another number of columns?",
            )
        columns["ring"] = rows[:, 4].astype(np.int64)
    elif rows.shape[1] > 4:
        columns |= {f"extra{number}": rows[:, number] for number in range(4, rows.shape[1])}
        if _has_rings(rows):
            columns["ring"] = columns.pop("extra4").astype(np.int64)
    return columns


def _column_count(file: SweepFile, dialect: Dialect) -> tuple[int, bool]:
    """Columns of a ``.bin``, and whether a file beside it says so."""
    if file.info is None:
        return dialect.bin_columns, False
    tree = read_json(file.info)
    count = tree.get("num_pts_feats", dialect.bin_columns) if isinstance(tree, dict) else None
    if type(count) is not int or not 4 <= count <= _MOST_COLUMNS:
        expected = f"an object with num_pts_feats from 4 to {_MOST_COLUMNS}"
        raise FileFormatError(file.info, where="the file", expected=expected, got=repr(count)[:60])
    return count, "num_pts_feats" in tree


def _rows(data: bytes, count: int) -> Float[np.ndarray, "n c"] | None:
    if len(data) % (4 * count):
        return None
    return np.frombuffer(data, dtype="<f4").reshape(-1, count)


def _are_rings(values: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    with np.errstate(invalid="ignore"):
        return np.asarray((values >= -1) & (values < MAX_RINGS) & (values == np.round(values)))


def _has_rings(rows: Float[np.ndarray, "n c"]) -> bool:
    return bool(_are_rings(rows[:, 4]).all())


def _has_intensities(rows: Float[np.ndarray, "n c"]) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((rows[:, 3] >= 0) & (rows[:, 3] <= FULL_INTENSITY)).all())


def _points(file: SweepFile, columns: dict[str, np.ndarray]) -> tuple[Float[np.ndarray, "k 3"], Bool[np.ndarray, " n"]]:
    """Points in the sensor's axes, in float64, and which rows they are; takes x, y and z out of the columns."""
    points_m = np.column_stack([columns.pop(axis) for axis in "xyz"])
    if points_m.dtype.kind != "f":
        raise FileFormatError(file.path, where="x, y, z", expected="float32 or float64", got=str(points_m.dtype))
    valid = returned(file.path, points_m)
    return points_m[valid].astype(np.float64), valid


def _lagged(
    file: SweepFile, columns: dict[str, np.ndarray], time_us: int, valid: Bool[np.ndarray, " n"]
) -> dict[str, np.ndarray]:
    """The further columns of the points that are there, with their age; where each has a time, by that."""
    extra = {name: values[valid] for name, values in columns.items()}
    if "timestamp" not in extra:
        lag_s = (time_us - file.time_us) * 1e-6
        return {**extra, "lag_s": np.full(int(valid.sum()), lag_s, dtype=np.float32)}
    offset_ns = _offsets_ns(file, extra.pop("timestamp"), time_us)
    return {**extra, "offset_ns": offset_ns, "lag_s": (-1e-9 * offset_ns).astype(np.float32)}


def _offsets_ns(file: SweepFile, stamps: Shaped[np.ndarray, " n"], time_us: int) -> Int64[np.ndarray, " n"]:
    """Nanoseconds since the frame's time of stamps in microseconds since 1970."""
    if stamps.dtype.kind not in "iu" and stamps.dtype != np.float64:
        got = str(stamps.dtype)
        raise FileFormatError(file.path, where="timestamp", expected="whole microseconds of 64 bits", got=got)
    with np.errstate(invalid="ignore"):
        seconds = (stamps.astype(np.float64) - float(file.time_us)) * 1e-6
        near = np.abs(seconds) <= _MOST_LAG_S
    if not near.all():
        raise FileFormatError(
            file.path,
            where="timestamp",
            expected=f"microseconds since 1970, within {_MOST_LAG_S:g} s of the file's time {file.time_us}",
            got=f"{stamps[~near][0]}",
        )
    return (stamps.astype(np.int64) - time_us) * 1000


def _radar(file: SweepFile, dialect: Dialect, time_us: int, intensity_scale: float | None) -> Cloud:
    del intensity_scale
    if file.path.suffix.lower() != ".pcd":
        raise DatasetError(
            f"{file.path}: expected a radar's points as .pcd; objects of a radar in {file.path.suffix} are not read"
        )
    columns = _pcd_columns(file.path)
    vectors = [name for names in dialect.rotated for name in names]
    missing = [name for name in (*_RADAR_FIELDS, *vectors[:2]) if name not in columns]
    if missing:
        expected = f"x, y, z, {', '.join(vectors)} and rcs of {dialect.title}'s radar"
        raise FileFormatError(file.path, where="FIELDS", expected=expected, got=", ".join(columns)[:120])
    if len(columns["x"]) and any(np.isnan(values[0]) for values in columns.values() if values.dtype.kind == "f"):
        columns = {name: values[:0] for name, values in columns.items()}  # by which the set marks an empty sweep
    points_m, valid = _points(file, columns)
    extra = _lagged(file, columns, time_us, valid)
    odd = [name for name in (*vectors, "rcs") if name in extra and not np.isfinite(extra[name]).all()]
    if odd:
        raise FileFormatError(file.path, where=odd[0], expected="finite numbers", got="NaN or infinity")
    range_m = np.linalg.norm(points_m, axis=1)
    for names in dialect.rotated:
        if not all(name in extra for name in names):
            continue
        vector = np.zeros((len(points_m), 3))
        vector[:, : len(names)] = np.column_stack([extra[name] for name in names])
        if "doppler_m_s" not in extra:  # the first of them is relative to the sensor
            along = np.einsum("ij,ij->i", vector, points_m) / np.maximum(range_m, 1e-9)
            extra["doppler_m_s"] = along.astype(np.float32)
        turned = (vector @ file.frame_T_sensor[:3, :3].T).astype(np.float32)
        third = names[0].replace("x", "z", 1) if len(names) == 2 else names[2]
        extra |= dict(zip((*names[:2], third), turned.T, strict=True))
    moved = transform_points(file.frame_T_sensor, points_m).astype(np.float32)
    return Cloud(moved, None, extra, int((~valid).sum()))
