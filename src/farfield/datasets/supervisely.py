"""Read Supervisely's projects of point clouds and of episodes, and CVAT's "Sly Point Cloud" exports.

A root is a data set of a project, or a project::

    <episode>/annotation.json, frame_pointcloud_map.json, pointcloud/*.pcd       episodes
    <data set>/ann/<cloud file>.json, pointcloud/*.pcd                           point clouds

An episode stands in Supervisely's axes. ``ann/`` may be Supervisely's own or CVAT's, which write the same keys with the
length along y and along x: the boxes' longer sides decide, or ``label_axes``.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from farfield.datasets.labelled_clouds import (
    LabelledCloud,
    LabelledClouds,
    clouds_in,
    folders_with,
    names_of_folders,
)
from farfield.datasets.labels.tool_labels import SuperviselyLabels
from farfield.errors import ConfigError, DatasetError, FarfieldError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import CuboidEntry
from farfield.files.point_times import PointTimes
from farfield.files.supervisely import (
    AXES,
    MAX_BYTES,
    Axes,
    longer_sides,
    parse_episode,
    parse_frame_map,
    parse_supervisely,
)
from farfield.vocabulary.classes import CIRRUS_FROM_TOOLS, normalised_class

EPISODE, FRAME_MAP = "annotation.json", "frame_pointcloud_map.json"
_LOOKED_AT = 200  # label files, spread
_LONG = ("vehicle", "large_vehicle", "bicycle", "motorcycle", "trailer")


def is_supervisely(root: Path) -> bool:
    """Whether a folder is a data set of Supervisely, or a project of some."""
    return bool(folders_with(root, _is_data_set))


def _is_data_set(folder: Path) -> bool:
    return _is_episode(folder) or (_has(folder / "ann", "*.json") and bool(clouds_in(folder / "pointcloud")))


def _is_episode(folder: Path) -> bool:
    return (folder / EPISODE).is_file() and (folder / FRAME_MAP).is_file()


def _has(folder: Path, pattern: str) -> bool:
    return next(iter(folder.glob(pattern)), None) is not None


def parse_either(data: bytes, path: Path | str, *, axes: Axes, episode: bool) -> tuple[CuboidEntry, ...]:
    """The cuboids of an episode's file or of one cloud's; errors are those of :mod:`farfield.files.supervisely`."""
    return parse_episode(data, path, axes=axes) if episode else parse_supervisely(data, path, axes=axes)


class Supervisely(LabelledClouds):
    """Supervisely's point clouds: ``"lidar"``, boxes whose tracks are the objects' keys; each data set is a sequence.

    Args:
        root: A data set, or a project of some.
        label_axes: Whose axes the boxes of ``ann/`` have, ``"supervisely"`` (the width is x) or ``"cvat"`` (the length
            is x); None decides by the longer sides of vehicles and bicycles.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is none, or label files belong to no cloud.
        ConfigError: If there are no such axes.
        FileFormatError: If an episode's map of frames is damaged.
    """

    name = "supervisely"
    looked_at = f"{EPISODE} with {FRAME_MAP} and pointcloud/, or ann/*.json with pointcloud/"
    parser = parse_either

    def __init__(
        self,
        root: Path | str,
        *,
        label_axes: str | None = None,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        if label_axes not in (None, *AXES):
            raise ConfigError(f"label_axes: expected one of {', '.join(AXES)}, got {label_axes!r}")
        self.label_axes = label_axes
        super().__init__(root, bin_columns=bin_columns, intensity_scale=intensity_scale, point_times=point_times)

    def find(self) -> Sequence[LabelledCloud]:
        """The clouds of all data sets; those of an episode in the order of its map."""
        folders = folders_with(self.root, _is_data_set)
        names = names_of_folders(self.root, folders)
        return [member for folder in folders for member in (_episode if _is_episode(folder) else _set)(folder, names)]

    def parsing(self, path: Path) -> Mapping[str, Any]:
        """The axes, and whether a file is an episode's."""
        episode = path.name == EPISODE and path.parent.name != "ann"
        return {"axes": self.label_axes or ("supervisely" if episode else self._axes[0]), "episode": episode}

    @cached_property
    def _axes(self) -> tuple[Axes, str]:
        """The axes of ``ann/``, and by what they were decided."""
        paths = [member.labels for member in self.members if not member.within and member.labels.is_file()]
        counts = [0, 0]
        for path in paths[:: max(1, len(paths) // _LOOKED_AT)]:
            try:
                entries = parse_supervisely(read_bytes(path, max_bytes=MAX_BYTES), path)
            except (FarfieldError, OSError):  # said when the file is read
                continue
            entries = tuple(
                entry for entry in entries if normalised_class(entry.cuboid.label, CIRRUS_FROM_TOOLS) in _LONG
            )
            counts = [one + other for one, other in zip(counts, longer_sides(entries), strict=True)]
        along_x, along_y = counts
        axes: Axes = "cvat" if along_x > along_y else "supervisely"
        return axes, f"{along_x} longer along x, {along_y} along y"

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Whose axes the boxes of ``ann/`` were taken to have."""
        if self.label_axes is not None or all(member.within for member in self.members):
            return ()
        axes, basis = self._axes
        words = {
            "cvat": "CVAT's boxes, whose length is x",
            "supervisely": "Supervisely's boxes, whose width is x and which head along y",
        }
        return (f"ann/ was taken for {words[axes]} (vehicles and bicycles: {basis}); --label-axes overrules",)


def _episode(folder: Path, names: Mapping[Path, str]) -> list[LabelledCloud]:
    path = folder / FRAME_MAP
    frames = parse_frame_map(read_bytes(path, max_bytes=MAX_BYTES), path)
    clouds = {cloud.name: cloud for cloud in clouds_in(folder / "pointcloud")}
    for mapped in frames:
        if mapped not in clouds:
            raise DatasetError(
                f"{path}: expected clouds of {folder / 'pointcloud'}, found {mapped!r}, which is not there"
            )
    order = sorted(frames, key=lambda name: int(frames[name]))
    return [
        LabelledCloud(cloud=clouds[name], sequence=names[folder], labels=folder / EPISODE, within=frames[name])
        for name in order
    ]


def _set(folder: Path, names: Mapping[Path, str]) -> list[LabelledCloud]:
    clouds, ann = clouds_in(folder / "pointcloud"), folder / "ann"
    strays = sorted({path.name for path in ann.glob("*.json")} - {f"{cloud.name}.json" for cloud in clouds})
    if strays and len(strays) == sum(1 for _ in ann.glob("*.json")):
        raise DatasetError(
            f"{ann}: expected files called like the clouds, such as {clouds[0].name}.json, found {strays[0]}. Name "
            "them so."
        )
    return [LabelledCloud(cloud=cloud, sequence=names[folder], labels=ann / f"{cloud.name}.json") for cloud in clouds]


def label_format(data: Supervisely) -> SuperviselyLabels | None:
    """The label files of a data set, to edit them; None where episodes and single clouds are mixed."""
    members = list(zip(data.keys, data.members, strict=True))
    frames = {key: member.within for key, member in members if member.within}
    if frames and len(frames) < len(members):
        return None
    axes: Axes = data.parsing(members[0][1].labels)["axes"]
    return SuperviselyLabels({key: member.labels for key, member in members}, axes, frames)
