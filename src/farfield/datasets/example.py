"""A small data set in the layout of own folders, made without a simulator: what a newcomer's own data should look like.

A car drives ahead of the sensor, another is parked, a pedestrian stands by the road; the points lie on the road and on
the faces of the boxes that a sensor on the roof sees. It shows the layout, and is no data to learn from.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from farfield.errors import ConfigError
from farfield.files.atomic import open_atomic, write_text
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.geometry.boxes import Boxes
from farfield.jobs.folders import held

FRAMES = 4
_STEP_S = 0.1
_ROAD_Z_M = -2.0
_SIZES_M = {"vehicle": (4.5, 1.9, 1.6), "pedestrian": (0.8, 0.7, 1.8)}

_README = """An example of an own data set, written by `farfield new-dataset`.

NUMBER.npy       one sweep each: rows of x, y, z (metres; x forward, y left, z up) and intensity (0 to 1)
labels.csv       the annotated boxes of all sweeps: a row a box, `frame` is the cloud's name without suffix
detections.csv   made-up detections of the same sweeps, to try `farfield score`

Replace the sweeps and labels.csv by your own. Then:

    farfield doctor FOLDER
    farfield score FOLDER/detections.csv FOLDER/labels.csv
    farfield evaluate pointpillars-cirrus-sim FOLDER
"""


def write_example(folder: Path | str, *, seed: int = 0) -> list[Path]:
    """Write the example: four sweeps as ``.npy``, ``labels.csv``, ``detections.csv`` and ``README.txt``.

    Args:
        folder: Where to; it must be absent or empty.
        seed: Another seed draws other points.

    Returns:
        The files.

    Raises:
        ConfigError: If something stands there already.
    """
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and _is_unfinished(folder)):
        raise ConfigError(f"{folder}: expected a new or empty folder, since nothing is written over; name another")
    with held(folder):
        return _write(folder, seed)


def _is_unfinished(folder: Path) -> bool:
    """Whether a folder holds nothing but what a killed command wrote of this example, whose last file is missing."""
    names = {path.name for path in folder.iterdir() if not path.name.endswith(".part")}
    return names <= {*_OTHERS[:-1], *(f"{number:04d}.npy" for number in range(FRAMES))}


def _write(folder: Path, seed: int) -> list[Path]:
    rng = np.random.default_rng(seed)
    frames = {f"{number:04d}": _boxes(number * _STEP_S) for number in range(FRAMES)}
    for stem, boxes in frames.items():
        with open_atomic(folder / f"{stem}.npy") as handle:
            np.save(handle, _sweep(boxes, rng))
    write_boxes_csv(folder / "labels.csv", _rows(frames))
    write_boxes_csv(folder / "detections.csv", _rows({stem: _detected(boxes, rng) for stem, boxes in frames.items()}))
    write_text(folder / "README.txt", _README)
    return [*(folder / f"{stem}.npy" for stem in frames), *(folder / name for name in _OTHERS)]


_OTHERS = ("labels.csv", "detections.csv", "README.txt")


def _boxes(time_s: float) -> Boxes:
    label = ["vehicle", "vehicle", "pedestrian"]
    size = np.array([_SIZES_M[name] for name in label])
    centre = np.array([[25.0 + 8.0 * time_s, -1.5, 0.0], [40.0, 6.0, 0.0], [18.0, 5.0, 0.0]])
    centre[:, 2] = _ROAD_Z_M + size[:, 2] / 2
    return Boxes(centre_m=centre, size_m=size, yaw_rad=np.array([0.0, 0.3, 0.0]), label=np.array(label))


def _sweep(boxes: Boxes, rng: np.random.Generator) -> Float32[np.ndarray, "n 4"]:
    """The road and the boxes' sides that face the sensor, with an intensity."""
    parts = [np.column_stack([rng.uniform(2, 70, 6000), rng.uniform(-15, 15, 6000), np.full(6000, _ROAD_Z_M)])]
    parts += [_faces(boxes[[row]], rng) for row in range(len(boxes))]
    points = np.concatenate(parts)
    points += rng.normal(0.0, 0.01, points.shape)
    return np.column_stack([points, rng.uniform(0.05, 0.6, len(points))]).astype(np.float32)


def _faces(box: Boxes, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Points on the rear and the side of a box that look at the origin."""
    count = 300
    sides = -np.sign(box.centre_m[0, :2])
    unit = rng.uniform(-0.5, 0.5, (count, 3))
    unit[: count // 2, 0] = sides[0] * 0.5
    unit[count // 2 :, 1] = sides[1] * 0.5
    local = unit * box.size_m[0]
    cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
    turned = np.column_stack(
        [local[:, 0] * cos - local[:, 1] * sin, local[:, 0] * sin + local[:, 1] * cos, local[:, 2]]
    )
    return turned + box.centre_m[0]


def _detected(boxes: Boxes, rng: np.random.Generator) -> Boxes:
    """The boxes a little off, with scores, and one that is nowhere."""
    off = boxes.replace(
        centre_m=boxes.centre_m + rng.normal(0, 0.1, boxes.centre_m.shape), score=np.array([0.9, 0.8, 0.6])
    )
    ghost = boxes[[0]].replace(centre_m=np.array([[55.0, -8.0, -1.2]]), score=np.array([0.3]))
    return Boxes.concatenate([off, ghost])


def _rows(frames: dict[str, Boxes]) -> BoxRows:
    together = Boxes.concatenate(list(frames.values()))
    return BoxRows(
        frame=np.repeat(list(frames), [len(boxes) for boxes in frames.values()]),
        label=np.asarray(together.label),
        centre_m=together.centre_m,
        size_m=together.size_m,
        yaw_rad=together.yaw_rad,
        score=together.score,
    )
