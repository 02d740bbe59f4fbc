"""What tells the dialects of the nuScenes schema apart: where tables stand, which there are, what files hold.

Sources: docs/schema_nuscenes.md of https://github.com/nutonomy/nuscenes-devkit, docs/schema_truckscenes.md of
https://github.com/TUMFTM/truckscenes-devkit, docs/schema of https://github.com/tier4/t4-devkit.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from farfield.vocabulary.classes import CIRRUS_FROM_NUSCENES, CIRRUS_FROM_T4, CIRRUS_FROM_TRUCKSCENES

_COMMON = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)
_MARKS = ("sample_data", "sample", "scene", "ego_pose", "calibrated_sensor", "sensor")
_LIDAR_LABELS = ("lidarseg", "panoptic")


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """One dialect of the schema.

    Args:
        name: Its name.
        title: What people call it.
        tables: The tables that there must be.
        lacks: Tables that there must not be: what tells it from the others.
        unread: Tables and folders that are not read, with what they hold.
        versions: What the folder of the tables is called, as a regular expression; None for ``annotation``.
        reference: What a sample's coordinates are: the car at the time of its key LiDAR sweep, or at the pose that is
            nearest to the sample's time.
        bin_columns: Columns of a LiDAR's ``.bin`` unless a file beside it says others.
        undecided_columns: Whether files of four columns occur too, so that the numbers are looked at.
        rotated: Columns of a radar's PCD that are vectors in the sensor's axes, x, y and perhaps z.
        classes: Classes of Cirrus by category.
    """

    name: str
    title: str
    tables: tuple[str, ...]
    lacks: tuple[str, ...] = ()
    unread: Mapping[str, str]
    versions: str | None
    reference: Literal["sweep", "pose"] = "sweep"
    bin_columns: int = 5
    undecided_columns: bool = False
    rotated: tuple[tuple[str, ...], ...] = (("vx", "vy"), ("vx_comp", "vy_comp"))
    classes: Mapping[str, str]


NUSCENES = Dialect(
    name="nuscenes",
    title="nuScenes",
    tables=(*_COMMON, "log", "map"),
    unread={**dict.fromkeys(_LIDAR_LABELS, "classes of LiDAR points"), "image_annotations": "boxes in images"},
    versions=r"v1\.0-[a-z][a-z0-9_-]*",
    classes=CIRRUS_FROM_NUSCENES,
)
TRUCKSCENES = Dialect(
    name="truckscenes",
    title="MAN TruckScenes",
    tables=(*_COMMON, "ego_motion_cabin", "ego_motion_chassis"),
    lacks=("map",),
    unread={
        "ego_motion_cabin": "motion of the cabin",
        "ego_motion_chassis": "motion of the chassis",
        "weather_annotation": "weather",
    },
    versions=r"v1\.\d+-(mini|trainval|test)",
    reference="pose",
    rotated=(("vrel_x", "vrel_y", "vrel_z"),),
    classes=CIRRUS_FROM_TRUCKSCENES,
)
T4 = Dialect(
    name="t4",
    title="Tier IV T4",
    tables=(*_COMMON, "log", "map"),
    unread={
        **dict.fromkeys(_LIDAR_LABELS, "classes of LiDAR points"),
        "object_ann": "boxes in images",
        "surface_ann": "surfaces in images",
        "keypoint": "points in images",
        "traffic_light": "traffic lights",
        "vehicle_state": "state of the car",
    },
    versions=None,
    undecided_columns=True,
    classes=CIRRUS_FROM_T4,
)
DIALECTS: Mapping[str, Dialect] = {dialect.name: dialect for dialect in (NUSCENES, TRUCKSCENES, T4)}


class TableFolder(NamedTuple):
    """Where a data set of the schema stands: its own folder, that of its tables, and the version it is called."""

    root: Path
    tables: Path
    version: str


def table_folders(root: Path, dialect: Dialect) -> list[TableFolder]:
    """The data sets of a dialect in a folder, in the order of their names."""
    return [folder for folder in _candidates(root, dialect) if _fits(folder.tables, dialect)]


def _candidates(root: Path, dialect: Dialect) -> Iterator[TableFolder]:
    if dialect.versions is not None:
        for path in sorted(root.glob("v1.*")):
            if re.fullmatch(dialect.versions, path.name):
                yield TableFolder(root, path, path.name)
        return
    for pattern in ("annotation", "*/annotation", "*/*/annotation"):  # <id>/<version>/annotation
        folders = [TableFolder(path.parent, path, path.parent.name) for path in sorted(root.glob(pattern))]
        if any(_fits(folder.tables, dialect) for folder in folders):
            yield from folders
            return


def _fits(tables: Path, dialect: Dialect) -> bool:
    """Whether a folder has what every data set of the schema has, and what tells this dialect from the others."""
    if not all((tables / f"{name}.json").is_file() for name in _MARKS):
        return False
    if dialect.versions is None:
        return True
    has_map = (tables / "map.json").is_file()
    return has_map if dialect.name == "nuscenes" else not has_map


def is_nuscenes(root: Path) -> bool:
    """Whether a folder holds nuScenes' tables."""
    return bool(table_folders(root, NUSCENES))


def is_truckscenes(root: Path) -> bool:
    """Whether a folder holds MAN TruckScenes' tables."""
    return bool(table_folders(root, TRUCKSCENES))


def is_t4(root: Path) -> bool:
    """Whether a folder holds data sets of Tier IV's T4."""
    return bool(table_folders(root, T4))
