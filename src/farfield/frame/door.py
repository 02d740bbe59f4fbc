"""What people hold a sweep in, as a :class:`Frame`: one door for paths, arrays, tables, clouds and frames.

Nothing behind it asks what it was. What an array cannot be is refused by name: rows that are columns, millimetres,
angles in the place of metres, an image.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import ConfigError, DatasetError
from farfield.files.remote_paths import as_path
from farfield.files.tables import columns_in
from farfield.frame.cloud import CLOUD_SUFFIXES, Cloud
from farfield.frame.record import Frame

FRAME_TAKES = (
    "a Frame, a Cloud, the path of a cloud file, an array of rows x, y, z (and intensity) in metres, or a table with "
    "the columns x, y, z"
)
_FARTHEST_M, _NEAREST_M = 1000.0, 1.0
"""Half of the points of a sweep lie nearer than the first; the farthest lies farther than the second."""
_LEAST_ROWS = 50
"""With fewer points their units are not judged."""


def frame_of(value: Any, *, frame_id: str = "0", sequence: str = "memory") -> Frame:
    """One sweep as a frame.

    Args:
        value: A frame, a cloud, a path, an array (n, 3) or wider, or a table with the columns x, y, z and perhaps
            intensity and others. Tensors on the CPU count as arrays.
        frame_id: Name of a frame that has none.
        sequence: Name of its sequence.

    Raises:
        ConfigError: If it is nothing of these, or an array cannot be what it is taken for.
        DatasetError: If there is no such file, or coordinates are not finite.
        FileFormatError: If the file is damaged.
    """
    if isinstance(value, Frame):
        return value
    if isinstance(value, str | Path):
        return Frame.of(_read(as_path(value).expanduser()), frame_id=Path(value).stem, sequence=sequence)
    return Frame.of(cloud_of(value), frame_id=frame_id, sequence=sequence)


def cloud_of(value: Any) -> Cloud:
    """Points as a cloud; arguments and errors are those of :func:`frame_of`, without frames and paths."""
    if isinstance(value, Cloud):
        return value
    columns = columns_in(value)
    if columns is not None:
        return _of_columns(columns)
    try:
        rows = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ConfigError(f"expected {FRAME_TAKES}; got {type(value).__name__} ({str(error)[:120]})") from None
    if rows.dtype.kind not in "fiu" or not rows.ndim:
        of = f" of {rows.dtype}" if rows.ndim else ""
        raise ConfigError(f"expected {FRAME_TAKES}; got {type(value).__name__}{of}")
    check_points(rows)
    return Cloud.of(rows)


def check_points(rows: Shaped[np.ndarray, "..."]) -> None:
    """Refuse an array that cannot be the points of a sweep in metres.

    Args:
        rows: Any array of numbers.

    Raises:
        ConfigError: If its shape, its units or its columns cannot be those.
    """
    if rows.ndim == 3 and rows.shape[2] >= 3:
        raise ConfigError(
            f"array: expected a row a point, got shape {rows.shape}: of an organised cloud give "
            f"array.reshape(-1, {rows.shape[2]}), of a batch a list of its sweeps; of a picture nothing"
        )
    if rows.ndim != 2 or rows.shape[1] < 3:
        turned = ": its columns are points, give array.T" if rows.ndim == 2 and 3 <= rows.shape[0] <= 16 else ""
        raise ConfigError(
            f"array: expected rows x, y, z (and intensity), shape (n, 3) or wider; got {rows.shape}{turned}"
        )
    if rows.shape[0] in (3, 4, 5) and rows.shape[1] > 16:
        raise ConfigError(
            f"array: expected a row a point, got shape {rows.shape}: its columns are points, give array.T"
        )
    if len(rows) < _LEAST_ROWS:
        return
    places = rows[:, :3].astype(np.float64)
    places = places[np.isfinite(places).all(axis=1) & (places != 0).any(axis=1)]
    if not len(places):
        return
    range_m = np.linalg.norm(places, axis=1)
    middle, farthest = float(np.median(range_m)), float(range_m.max())
    if middle > _FARTHEST_M:
        raise ConfigError(
            f"array: expected metres from the sensor, got points of which half lie beyond {middle:,.0f}: millimetres "
            "(divide by 1000), or coordinates of a map (subtract the sensor's place)?"
        )
    if farthest < _NEAREST_M:
        raise ConfigError(
            f"array: expected metres from the sensor, got points of which the farthest lies {farthest:.3g} away: "
            "kilometres, or scaled to one? Give metres"
        )
    ahead, azimuth, elevation = places.T
    if ahead.min() >= 0 and farthest > 10 and np.abs(azimuth).max() <= np.pi and np.abs(elevation).max() <= np.pi / 2:
        raise ConfigError(
            f"array: expected x, y, z in metres, got second and third columns within {np.abs(azimuth).max():.3g} and "
            f"{np.abs(elevation).max():.3g} beside a first one up to {ahead.max():.4g}: range, azimuth and elevation? "
            "Give x, y, z; of a cut so narrow give a Cloud"
        )


def collate(frames: Sequence[Frame]) -> dict[str, list[Any]]:
    """A batch of frames as lists of arrays: ``torch.utils.data.DataLoader(data, collate_fn=ff.collate)``.

    Arrays are read where this runs, in the loader's workers, and have the lengths that they have.

    Args:
        frames: The frames of the batch.

    Returns:
        ``frame``: the frames; ``points``: x, y, z and intensity of the first cloud of each, float32 (n, 4);
        ``boxes``: annotated boxes, float32 (m, 7) of x, y, z, length, width, height, yaw; ``labels``: their classes;
        ``annotated``: whether the frame was annotated at all.
    """
    batch: dict[str, list[Any]] = {name: [] for name in ("frame", "points", "boxes", "labels", "annotated")}
    for frame in frames:
        cloud = frame.cloud(next(iter(frame.clouds)))
        strength = np.zeros(len(cloud), dtype=np.float32) if cloud.intensity is None else cloud.intensity
        boxes = frame.boxes
        batch["frame"].append(frame)
        batch["points"].append(np.column_stack([cloud.points_m, strength]))
        batch["boxes"].append(np.zeros((0, 7), np.float32) if boxes is None else boxes.to_numpy().astype(np.float32))
        batch["labels"].append([] if boxes is None else boxes.label.tolist())  # type: ignore[union-attr]
        batch["annotated"].append(boxes is not None)
    return batch


def _read(path: Path) -> Cloud:
    if path.is_dir():
        raise DatasetError(f"{path}: expected a cloud file, got a folder: farfield.open_dataset opens a data set's")
    if path.suffix.lower() not in CLOUD_SUFFIXES:
        raise ConfigError(
            f"{path}: expected a cloud file ({', '.join(CLOUD_SUFFIXES)}), got {path.suffix or 'no suffix'}"
        )
    return Cloud.from_file(path)


def _of_columns(columns: dict[str, Shaped[np.ndarray, " n"]]) -> Cloud:
    """A cloud of named columns: x, y, z or x_m, y_m, z_m, intensity, and others as they are."""
    places = [next((name for name in (axis, f"{axis}_m") if name in columns), "") for axis in "xyz"]
    if not all(places):
        raise ConfigError(f"table: expected the columns x, y, z (in metres), got {', '.join(columns)[:200] or 'none'}")
    strength = columns.get("intensity")
    rows = np.column_stack([columns[name] for name in places] + ([] if strength is None else [strength]))
    if rows.dtype.kind not in "fiu":
        raise ConfigError(f"table: expected numbers as {', '.join(places)}, got {rows.dtype}")
    check_points(rows)
    others = {name: column for name, column in columns.items() if name not in (*places, "intensity")}
    numbers = {name: column for name, column in others.items() if column.dtype.kind in "fiu"}
    cloud = Cloud.of(rows)
    return Cloud(cloud.points_m, None if strength is None else cloud.intensity, numbers, cloud.missing)
