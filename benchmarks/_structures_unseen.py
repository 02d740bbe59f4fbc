"""Other people's data sets, whose generators stand in the test tree: one change of the structure of one file.

What has to come out is an error of ours or a frame without contradictions; where the change puts a number outside what
the schema bounds, the same frame as before, words about it, or an error.
"""

import signal
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import MissingError
from _structures import Case, Family, Reading, apart
from _tree_mutations import mutate_tree

import farfield as ff
from farfield.errors import DatasetError

try:
    from datasets.generators import (
        aimotive,
        argoverse1,
        captures,
        custom,
        dual_radar,
        kradar,
        nuscenes_trees,
        pandaset,
        ros1,
        scale_trees,
        waymo,
        zod,
    )
except ModuleNotFoundError:
    raise MissingError(
        "the generators of other people's data sets stand in the test tree: PYTHONPATH=tests python "
        "benchmarks/fuzz_structures.py --part unseen"
    ) from None

LONGEST_S = 20
MOST_FRAMES = 3
FARTHEST_M = 1e7


def in_folder(write: Callable[[Path], Any], name: str, root: Path) -> None:
    """Write a file of a name into a folder."""
    write(root / name)


WRITERS: dict[str, Callable[[Path], Any]] = {
    "nuscenes": partial(nuscenes_trees.write_nuscenes, samples=2),
    "truckscenes": partial(nuscenes_trees.write_nuscenes, dialect="truckscenes", samples=2),
    "t4": partial(nuscenes_trees.write_nuscenes, dialect="t4", samples=2),
    "pandaset": partial(pandaset.write_pandaset, frames=2),
    "pandaset of pandas 2": partial(pandaset.write_pandaset, version="2.2", frames=2),
    "waymo": partial(waymo.write_waymo, frames=2),
    "zod": zod.write_zod,
    "aimotive": partial(aimotive.write_aimotive, frames=2),
    "argoverse1": partial(argoverse1.write_argoverse1, frames=2),
    "dual radar": dual_radar.write_dual_radar,
    "openpcdet": custom.write_custom,
    "mmdetection3d": partial(custom.write_custom, kind="mmdetection3d"),
    "vlp-16": partial(in_folder, partial(captures.write_vlp16, turns=1.3), "drive.pcap"),
    "pandar64": partial(in_folder, partial(captures.write_hesai, turns=1.3), "drive.pcap"),
    "xt32": partial(in_folder, partial(captures.write_hesai, model="xt32", turns=1.3), "drive.pcap"),
    "ros 1 bags": partial(in_folder, ros1.write_ros1, "drive.bag"),
    "scale": scale_trees.write_scale,
    "kradar shares": partial(kradar.write_kradar, frames=2),
}


@cache
def pristine(name: str) -> dict[str, bytes]:
    """The files of a generated tree, unchanged."""
    with tempfile.TemporaryDirectory() as folder:
        WRITERS[name](Path(folder))
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(Path(folder).rglob("*"))
            if path.is_file()
        }


@cache
def unchanged(name: str) -> Reading:
    """What a reader gives and says of the unchanged tree; nothing where it does not read it, which tests tell."""
    with tempfile.TemporaryDirectory() as folder:
        for other, data in pristine(name).items():
            path = Path(folder) / other
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        try:
            return read_tree(Path(folder))
        except Exception:
            return Reading(None)


def too_long(*_: Any) -> None:
    """What the alarm does."""
    raise TimeoutError(f"more than {LONGEST_S} s")


def read_tree(folder: Path) -> Reading:
    """All that a reader gives of a few frames, as arrays by name."""
    signal.signal(signal.SIGALRM, too_long)
    signal.alarm(LONGEST_S)
    try:
        data = ff.open_dataset(folder)
        values: dict[str, Any] = {"frames": len(data)}
        for drive in data.drives():
            values[f"times of {drive.name}"] = drive.times_ns
            values[f"poses of {drive.name}"] = drive.world_T_frame
        for number in range(min(len(data), MOST_FRAMES)):
            values |= of_frame(data[number], number)
        words = " ".join((*data.notes, *data.assumptions))
    except OSError as error:
        if error.filename is None:  # TimeoutError is one too
            raise
        raise DatasetError(f"{error.filename}: {error.strerror}") from error  # as the command line says it
    finally:
        signal.alarm(0)
    return Reading(values, words)


def of_frame(frame: Any, number: int) -> dict[str, Any]:
    """Clouds, boxes, times and poses of a frame; its pictures are read, and that is all."""
    values: dict[str, Any] = {f"{number} time": frame.time_ns, f"{number} pose": frame.world_T_frame}
    for name in frame.clouds:
        cloud = frame.cloud(name)
        values[f"{number} {name} points"] = cloud.points_m
        values[f"{number} {name} intensity"] = cloud.intensity
        values |= {f"{number} {name} {column}": column_values for column, column_values in cloud.extra.items()}
    for name in frame.images:
        np.asarray(frame.images[name])
    annotation = frame.annotation
    if annotation is not None:
        boxes = annotation.boxes
        for field in ("centre_m", "size_m", "yaw_rad", "label", "track_id", "point_count", "velocity_m_s"):
            values[f"{number} boxes {field}"] = getattr(boxes, field)
    return values


def contradictions(values: dict[str, Any]) -> str:
    """What of a frame cannot be; empty where nothing is wrong with it."""
    for name, value in values.items():
        if value is None or not isinstance(value, np.ndarray):
            continue
        if name.endswith("points") and len(value):
            if not np.isfinite(value).all():
                return f"{name}: not finite"
            if float(np.abs(value).max()) > FARTHEST_M:
                return f"{name}: {float(np.abs(value).max()):.4g} m away"
        if name.endswith("intensity") and not ((value >= 0) & (value <= 1)).all():
            return f"{name}: beyond 0 to 1"
        if ("pose" in name) and value.size:
            turn = value[..., :3, :3]
            if not np.isfinite(value).all() or np.abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max() > 1e-3:
                return f"{name}: no rigid motion"
    return ""


def changed(before: Any, words: Callable[[], str], values: dict[str, Any]) -> str:
    """What differs from before, where nothing was said."""
    wrong = contradictions(values)
    if wrong or before is None or words():
        return wrong
    for name in sorted({*before, *values}):
        old, new = before.get(name), values.get(name)
        if old is None or new is None:
            if old is not new:
                return f"{name}: {'lost' if new is None else 'new'}, without a word"
            continue
        wrong = apart(name, new, old)
        if wrong:
            return f"{wrong}, without a word"
    return ""


class Tree:
    """One changed tree and how it is read: what is said is kept for the comparison."""

    def __init__(self, folder: Path, usual: str) -> None:
        self.folder, self.usual, self.words = folder, usual, ""

    def read(self) -> Reading:
        """Read it."""
        reading = read_tree(self.folder)
        self.words = "" if reading.words == self.usual else reading.words
        return reading

    def said(self) -> str:
        """What it said that it does not say of the unchanged tree."""
        return self.words


def make(name: str, random: np.random.Generator, folder: Path) -> Case:
    """A case of one format."""
    words, bounded = mutate_tree(random, pristine(name), folder)
    before = unchanged(name)
    tree = Tree(folder, before.words)
    difference = partial(changed, before.values, tree.said) if bounded else contradictions
    return Case((words, *(("bounded",) if bounded else ())), "either", tree.read, difference)


FAMILIES = [Family(f"unseen {name}", partial(make, name), share=0.25) for name in WRITERS]
