"""Read releases of Segments.ai: the release's JSON, and its clouds anywhere below it, called as their addresses end.

Clouds of one name in several samples lie in folders called like the samples. The boxes, which the file has in world
coordinates, are brought into each cloud's by its ego pose; they are read, not edited.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.labelled_clouds import LabelledCloud, LabelledClouds, clouds_in
from farfield.errors import DatasetError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.point_times import PointTimes
from farfield.files.segments_ai import SegmentsFrame, parse_segments

_HEAD_BYTES, _DEEP, _LOOKED_AT = 1 << 16, 3, 20


def is_segments_ai(root: Path) -> bool:
    """Whether a folder holds a release of point clouds with cuboids."""
    return bool(releases(root))


def releases(root: Path) -> list[Path]:
    """The release files directly in a folder."""
    paths = sorted(path for path in root.glob("*.json") if path.is_file() and not path.name.startswith("."))
    return [path for path in islice(paths, _LOOKED_AT) if _is_release(path)]


def _is_release(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return b'"task_type"' in head and b'"pointcloud-cuboid' in head


def parse_release(data: bytes, path: Path | str, *, label_set: str) -> tuple[CuboidEntry, ...]:
    """The boxes of all frames; a box's frame is the frame's place in the file. Errors are those of the parser."""
    frames = enumerate(parse_segments(data, path, label_set=label_set))
    return tuple(_placed(number, cuboid) for number, frame in frames for cuboid in frame.cuboids or ())


def _placed(number: int, cuboid: Cuboid) -> CuboidEntry:
    return CuboidEntry((), replace(cuboid, frame=str(number)))


class SegmentsAi(LabelledClouds):
    """A release of Segments.ai: point cloud ``"lidar"``, boxes with tracks, ego poses; each sample is a sequence.

    Args:
        root: The folder of the release's JSON and its clouds.
        label_set: Which labels; empty: ``ground-truth``, or the only ones there.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is none, or several, or a cloud is missing.
        FileFormatError: If the release is damaged or of another task.
    """

    name = "segments_ai"
    looked_at = "a release of Segments.ai (*.json) with its clouds below it"
    parser = parse_release

    def __init__(
        self,
        root: Path | str,
        *,
        label_set: str = "",
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.label_set = label_set
        super().__init__(root, bin_columns=bin_columns, intensity_scale=intensity_scale, point_times=point_times)

    def find(self) -> Sequence[LabelledCloud]:
        """The clouds of all samples."""
        paths = releases(self.root)
        if len(paths) > 1:
            shown = ", ".join(path.name for path in paths)
            raise DatasetError(f"{self.root}: expected one release of Segments.ai, found {shown}. Leave one there")
        members: list[LabelledCloud] = []
        self._poses: list[Float[np.ndarray, "4 4"] | None] = []
        for path in paths:
            frames = parse_segments(read_bytes(path), path, label_set=self.label_set)
            clouds = _by_name(self.root)
            for number, frame in enumerate(frames):
                self._poses.append(frame.world_T_cloud)
                members.append(
                    LabelledCloud(
                        cloud=_cloud(path, frame, clouds),
                        sequence=frame.sample,
                        labels=path,
                        within=str(number),
                        annotated=frame.cuboids is not None,
                    )
                )
        return members

    def parsing(self, path: Path) -> Mapping[str, Any]:
        """The set of labels."""
        del path
        return {"label_set": self.label_set}

    def world_T_frame(self, index: int) -> Float[np.ndarray, "4 4"] | None:
        """The ego pose of frame ``index``; None without one."""
        return self._poses[index]


def _by_name(root: Path) -> dict[str, list[Path]]:
    names: dict[str, list[Path]] = {}
    folders = [root]
    for _ in range(_DEEP + 1):
        for folder in folders:
            for cloud in clouds_in(folder):
                names.setdefault(cloud.name, []).append(cloud)
        folders = sorted(inner for folder in folders for inner in folder.iterdir() if inner.is_dir())
    return names


def _cloud(path: Path, frame: SegmentsFrame, clouds: Mapping[str, list[Path]]) -> Path:
    """A frame's cloud: the only one of its name, or the one in the sample's folder.

    Raises:
        DatasetError: If there is none, or it cannot be told from others.
    """
    matches = clouds.get(frame.cloud, [])
    if len(matches) > 1:
        matches = [cloud for cloud in matches if frame.sample in (folder.name for folder in cloud.parents)]
    if len(matches) != 1:
        raise DatasetError(
            f"{path}: expected one cloud {frame.cloud!r} of sample {frame.sample!r} below {path.parent}, found "
            f"{len(matches) or 'none'}. Download the clouds, those of samples with clouds of the same names each into "
            "a folder of its name"
        )
    return matches[0]
