"""Dual-Radar's labels (Zhang et al., arXiv:2310.07602): KITTI's columns, then a score and the track's number.

Source: the authors' code, Apache-2.0, https://github.com/adept-thu/Dual-Radar (``object3d_dual_radar.py``,
``dual_radar_dataset_arbe.py``, ``dual_radar_dataset_ars548.py``).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.kitti import MAX_TEXT_BYTES, KittiObjects, parse_labels

COLUMNS = 17
LIDAR_T_RADAR: dict[str, Float[np.ndarray, "4 4"]] = {
    "arbe": np.array(
        [
            [0.9981128011677526, 0.05916115557244023, 0.016455814060541557, 0.07800451346438697],
            [-0.059503891609836816, 0.9980033119043885, -0.021181980812864695, 2.214080041485726],
            [0.015169806470300943, 0.022121191179620064, 0.9996402002082792, -1.6030740415943632],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "ars548": np.array(
        [
            [0.08065852999237734, -0.996741790402992, 6.930878282577699e-05, 0.07152088247656341],
            [0.9955755395152072, 0.0805607912438313, -0.04836635228309268, 1.9685450015593613],
            [0.04820318099952712, 0.003970161005102628, 0.9988296607345621, -1.1990909999923147],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
}
"""Where the radars stand in the LiDAR's coordinates (x right, y forward, z up), as the authors' code has it."""


@dataclass(frozen=True)
class DualRadarLabels:
    """The labels of a frame.

    Args:
        objects: In KITTI's columns.
        track_id: Of each.
    """

    objects: KittiObjects
    track_id: Int64[np.ndarray, " n"]


def read_track_labels(path: Path | str) -> DualRadarLabels:
    """The labels of a frame.

    Raises:
        FileFormatError: If a line has not 17 columns, or one holds anything but what belongs there.
    """
    data = read_bytes(path, max_bytes=MAX_TEXT_BYTES)
    lines, tracks = [], []
    for number, line in enumerate(data.split(b"\n"), start=1):
        words = line.split()
        if not words:
            lines.append(b"")
            continue
        if len(words) != COLUMNS:
            expected = f"{COLUMNS} columns: KITTI's 15, a score and the track's number"
            raise FileFormatError(path, where=f"line {number}", expected=expected, got=str(len(words)))
        tracks.append(_whole(words[-1], path, number))
        lines.append(b" ".join(words[:-1]))
    objects = parse_labels(b"\n".join(lines), path)
    return DualRadarLabels(objects, np.array(tracks, dtype=np.int64))


def _whole(word: bytes, path: Path | str, number: int) -> int:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if b"_" in word or not (abs(value) < 1 << 53 and value == int(value)):
        actual = repr(word[:40])
        raise FileFormatError(path, where=f"line {number}", expected="a track's whole number", got=actual)
    return int(value)
