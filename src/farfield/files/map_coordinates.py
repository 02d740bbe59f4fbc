"""Coordinates of maps (UTM, ECEF): what float32 cannot hold, and which origin is subtracted from LAS and LAZ clouds."""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Num, Shaped

from farfield.files.las import LasCloud, read_las

NEAREST_M = 1e4
"""The nearest point of a map's cloud lies beyond: clouds in millimetres begin nearer."""
MAP_SUFFIXES = (".las", ".laz")
"""Formats of surveyors, whose coordinates are as a rule those of a map."""

Origin = tuple[float, float, float]


def beyond_any_sensor(points_m: Num[np.ndarray, "n 3"]) -> float:
    """The distance of the nearest point, metres, where it is beyond what sensors see; 0 where it is not.

    What stands at the origin is no return and does not count.
    """
    if not len(points_m) or max(points_m.max(), -points_m.min()) <= NEAREST_M:  # not so for NaN: then it is looked at
        return 0.0
    range_m = np.linalg.norm(points_m.astype(np.float64), axis=1)
    range_m = range_m[np.isfinite(range_m) & (range_m > 0)]
    nearest_m = float(range_m.min()) if len(range_m) else 0.0
    return nearest_m if nearest_m > NEAREST_M else 0.0


def origin_of(path: Path, cloud: LasCloud) -> tuple[Origin, tuple[str, ...]]:
    """What is subtracted from a cloud's coordinates, and the notes on the cloud.

    Nothing where the points are near; else their middle, the median in whole metres, which does not follow single
    points far off. Where the sensor stood is not told by LAS.
    """
    places = np.column_stack([cloud.columns[axis] for axis in "xyz"])
    if not beyond_any_sensor(places):
        return (0.0, 0.0, 0.0), cloud.remarks
    x_m, y_m, z_m = np.rint(np.median(places, axis=0)).tolist()
    sentence = (
        f"{path}: coordinates of a map; ({x_m:.0f}, {y_m:.0f}, {z_m:.0f}) m, the middle of its points, is subtracted. "
        "Where the sensor stood, and which way it looked, is not told: ranges are from there"
    )
    return (x_m, y_m, z_m), (*cloud.remarks, sentence)


def read_map_cloud(path: Path, origin_m: Origin | None) -> Mapping[str, Shaped[np.ndarray, "..."]]:
    """The columns of a LAS or LAZ file, its coordinates in float64 less an origin.

    Args:
        path: The file.
        origin_m: What is subtracted; None decides by the file alone, and warns.

    Raises:
        FileFormatError: If the file is damaged, or not in metres.
    """
    cloud = read_las(path)
    if origin_m is None:
        origin_m, sentences = origin_of(path, cloud)
        for sentence in sentences:
            warnings.warn(sentence, stacklevel=4)
    return less_origin(cloud.columns, origin_m)


def less_origin(
    columns: Mapping[str, Shaped[np.ndarray, "..."]], origin_m: Origin
) -> Mapping[str, Shaped[np.ndarray, "..."]]:
    """Columns with an origin subtracted from x, y and z."""
    if not any(origin_m):
        return columns
    return {**columns, **{axis: columns[axis] - origin for axis, origin in zip("xyz", origin_m, strict=True)}}
