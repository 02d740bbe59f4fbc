"""Data sets as annotation tools take them, with their clouds; and OpenLABEL's boxes alone."""

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.labels.json_labels import TRACK_NAME, DatumaroLabels, OpenLabels, SustechLabels, file_name
from farfield.datasets.labels.tool_labels import LabelCloudLabels, Xtreme1Labels
from farfield.datasets.losses import Capacity, plain_details
from farfield.errors import DatasetError, FarfieldError
from farfield.files.atomic import write_text
from farfield.files.cuboids import Cuboid
from farfield.files.datumaro import format_datumaro
from farfield.files.images import write_image
from farfield.files.json_text import read_json
from farfield.files.labelcloud import format_labelcloud
from farfield.files.openlabel import format_openlabel
from farfield.files.pcd import write_pcd
from farfield.files.supervisely import format_episode, format_meta
from farfield.files.sustechpoints import format_calibration, format_sustechpoints
from farfield.files.xtreme1 import format_cameras, format_xtreme1
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.jobs import Unit, UnitResult
from farfield.vocabulary.classes import CIRRUS_FROM_TOOLS

AnnotationTool = Literal["openlabel", "sustechpoints", "cvat", "supervisely", "xtreme1", "labelcloud"]
BoxSource = Literal["boxes", "full_boxes"]
_POINT_BYTES = 12  # x, y, z as float32; text takes more
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)

OPENLABEL_HOLDS = Capacity(
    title="OpenLABEL",
    holds=frozenset({"times", "tracks", "empty frames"}),
    any_attributes=True,
    one_cloud=False,
    file_names=file_name,
    frame_names=True,
    reasons=dict.fromkeys(("clouds", "images", "cameras", "radar"), "labels alone are written"),
)
SUSTECHPOINTS_HOLDS = Capacity(
    title="SUSTechPOINTS' scenes",
    read_by="sustechpoints",
    holds=frozenset({"tracks", "empty frames"}),
    pictures="calibrated",
    aliases=CIRRUS_FROM_TOOLS,
    file_names=file_name,
    jpeg=True,
    reasons={"images": "only those of calibrated cameras", "cameras": "only those with an image"},
)
CVAT_HOLDS = Capacity(
    title="CVAT's tasks",
    read_by="cvat",
    holds=frozenset({"tracks", "empty frames"}),
    any_attributes=True,
    aliases=CIRRUS_FROM_TOOLS,
    file_names=file_name,
)
SUPERVISELY_HOLDS = Capacity(
    title="Supervisely's episodes",
    read_by="supervisely",
    holds=frozenset({"tracks", "empty frames"}),
    attributes=frozenset({TRACK_NAME}),
    aliases=CIRRUS_FROM_TOOLS,
    file_names=file_name,
    reasons={"attributes": "tags are of objects, not of their boxes"},
)
XTREME1_HOLDS = Capacity(
    title="Xtreme1's scenes",
    read_by="xtreme1",
    holds=frozenset({"tracks", "empty frames"}),
    any_attributes=True,
    pictures="calibrated",
    aliases=CIRRUS_FROM_TOOLS,
    file_names=file_name,
    jpeg=True,
    reasons={
        "images": "only those of calibrated cameras, by number",
        "cameras": "only those with an image",
    },
)
LABELCLOUD_HOLDS = Capacity(
    title="labelCloud's projects",
    read_by="labelcloud",
    holds=frozenset({"empty frames"}),
    aliases=CIRRUS_FROM_TOOLS,
    file_names=file_name,
)
_A_FRAME = ("sustechpoints", "xtreme1", "labelcloud")
"""Tools whose files are of one frame each."""


def spread(dataset: Dataset) -> list[int]:
    """Indices of up to five frames that are spread over a set."""
    return sorted({round(share * (len(dataset) - 1)) for share in _SHARES}) if len(dataset) else []


def cloud_bytes(dataset: Dataset, cloud: str | None) -> float:
    """What the points of a frame take: the median of a few frames that are spread over the set and can be read."""
    counts = []
    for index in spread(dataset):
        with suppress(FarfieldError):  # said where the frame is converted
            counts.append(len(dataset[index].cloud(cloud)))
    return _POINT_BYTES * float(np.median(counts or [0]))


def views(dataset: Dataset) -> str:
    """What else decides how a data set is seen: its reader's options and its maps; empty where there are none."""
    recipe = {name: dataset.recipe.get(name) for name in ("options", "maps")}
    return f" {json.dumps(recipe, sort_keys=True, default=str)}" if any(recipe.values()) else ""


def boxes_of(frame: Frame, source: BoxSource) -> Boxes | None:
    """The boxes to label: the frame's own, or its annotation's ``full_boxes``.

    Raises:
        DatasetError: If the whole bodies are wanted and not known.
    """
    if source == "boxes" or frame.annotation is None:
        return frame.boxes
    if frame.annotation.full_boxes is None:
        raise DatasetError(f"frame {frame.key}: expected full_boxes in its annotation, which boxes='full_boxes' takes")
    return frame.annotation.full_boxes


def cuboids_of(boxes: Boxes | None, frame: str, annotation: Annotation | None = None) -> list[Cuboid]:
    """Boxes as tools exchange them; the classes keep our names.

    Args:
        boxes: The boxes.
        frame: The frame's name in the file.
        annotation: What is known of them besides: rows of texts, numbers and flags become attributes, and names of
            tracks tracks.
    """
    if boxes is None or not len(boxes):
        return []
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).tolist()
    tracks = [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()
    names = [str(track) if track >= 0 else "" for track in tracks]
    details = {} if annotation is None else plain_details(annotation)
    if TRACK_NAME in details:
        names = [str(name) or own for name, own in zip(details.pop(TRACK_NAME), names, strict=True)]
    return [
        Cuboid(
            frame=frame,
            label=str(label),
            box=tuple(row),
            track=track,
            attributes={name: column[i] for name, column in details.items() if _is_there(column[i])},
        )
        for i, (label, row, track) in enumerate(zip(np.asarray(boxes.label).tolist(), rows, names, strict=True))
    ]


def _is_there(value: str | int | float | bool) -> bool:
    return value != "" and value == value  # NaN differs from itself


@dataclass(frozen=True, kw_only=True)
class ToolExport:
    """Writes sequences of a data set for an annotation tool; a unit's parameters are the frames' indices.

    SUSTechPOINTS and Xtreme1 get scenes with clouds (PCD), images, calibration and labels; CVAT clouds below
    ``point_clouds`` and one Datumaro file a sequence; Supervisely an episode a sequence; labelCloud a project a
    sequence; OpenLABEL one file a sequence.

    Args:
        dataset: The frames.
        target: Folder to write into.
        to: The tool.
        boxes: Which boxes to label.
        cloud: Which cloud to write; None takes the first.
    """

    dataset: Dataset
    target: Path
    to: AnnotationTool
    boxes: BoxSource
    cloud: str | None
    memory_bytes = 500_000_000

    @cached_property
    def disk_bytes(self) -> float:
        """What a unit takes on the disk at least: the points of its frames."""
        if self.to == "openlabel" or not len(self.dataset):
            return 0.0
        return cloud_bytes(self.dataset, self.cloud) * len(self.dataset) / len(self.units())

    @property
    def setting(self) -> str:
        """What decides the files besides their sources."""
        return f"{self.to} {self.boxes} {self.cloud} {self.dataset.name}{views(self.dataset)}"

    def units(self) -> list[Unit]:
        """One a sequence; for tools whose files are of one frame each, one a frame."""
        files = self.dataset.files
        if self.to in _A_FRAME:
            keys = enumerate(self.dataset.keys)
            return [Unit("/".join(key), tuple(files(index)), (index,)) for index, key in keys]
        groups: dict[str, list[int]] = {}
        for index, sequence in enumerate(self.dataset.sequences):
            groups.setdefault(sequence, []).append(index)
        return [
            Unit(name, tuple(dict.fromkeys(file for index in indices for file in files(index))), tuple(indices))
            for name, indices in groups.items()
        ]

    def __call__(self, unit: Unit) -> UnitResult:
        """Write one unit."""
        frames = [self.dataset.frame(index) for index in unit.parameters]
        if self.to in _A_FRAME:
            writes = {
                "sustechpoints": self._scene_frame,
                "xtreme1": self._xtreme1_frame,
                "labelcloud": self._labelcloud_frame,
            }
            return UnitResult(files=tuple(path for frame in frames for path in writes[self.to](frame)))
        if self.to == "supervisely":
            return UnitResult(files=tuple(self._episode(frames)))
        names = [frame.frame_id if self.to == "openlabel" else file_name(frame.frame_id) for frame in frames]
        cuboids = [
            cuboid
            for frame, name in zip(frames, names, strict=True)
            for cuboid in cuboids_of(boxes_of(frame, self.boxes), name, frame.annotation)
        ]
        if self.to == "openlabel":
            text = format_openlabel(cuboids, names, [frame.time_ns for frame in frames], system=frames[0].reference)
            return UnitResult(files=(_written(OpenLabels(self.target).path(frames[0].key), text),))
        path = _written(DatumaroLabels(self.target).path(frames[0].key), format_datumaro(cuboids, names))
        return UnitResult(files=(path, *self._clouds(frames, path.parents[1] / "point_clouds", names)))

    def _clouds(self, frames: Sequence[Frame], folder: Path, names: Sequence[str]) -> Iterable[Path]:
        for frame, name in zip(frames, names, strict=True):
            yield write_cloud(folder / f"{name}.pcd", frame.cloud(self.cloud))

    def _scene_frame(self, frame: Frame) -> list[Path]:
        label = SustechLabels(self.target).path(frame.key)
        scene, stem = label.parents[1], label.stem
        paths = [write_cloud(scene / "lidar" / f"{stem}.pcd", frame.cloud(self.cloud))]
        for name, camera in frame.cameras.items():
            if name in frame.images:
                path = scene / "camera" / file_name(name) / f"{stem}.jpg"
                path.parent.mkdir(parents=True, exist_ok=True)
                write_image(path, frame.images[name])
                calibration = format_calibration(camera.camera_T_lidar, camera.matrix)
                paths += [path, _written(scene / "calib" / "camera" / f"{file_name(name)}.json", calibration)]
        boxes = boxes_of(frame, self.boxes)
        if boxes is not None:
            paths.append(_written(label, format_sustechpoints(cuboids_of(boxes, stem))))
        label.parent.mkdir(parents=True, exist_ok=True)
        return paths

    def _episode(self, frames: Sequence[Frame]) -> Iterable[Path]:
        folder = self.target / file_name(frames[0].sequence)
        names = [file_name(frame.frame_id) for frame in frames]
        yield from self._clouds(frames, folder / "pointcloud", names)
        cuboids = [
            replace(cuboid, attributes={})
            for number, frame in enumerate(frames)
            for cuboid in cuboids_of(boxes_of(frame, self.boxes), str(number), frame.annotation)
        ]
        mapped = {str(number): f"{name}.pcd" for number, name in enumerate(names)}
        yield _written(folder / "frame_pointcloud_map.json", json.dumps(mapped, indent=1) + "\n")
        yield _written(folder / "annotation.json", format_episode(cuboids, len(frames), name=folder.name))

    def finish(self) -> None:
        """Write what is of the whole project: Supervisely's classes, from the episodes that stand there."""
        if self.to != "supervisely":
            return
        labels: set[str] = set()
        for path in sorted(self.target.glob("*/annotation.json")):
            labels |= {str(entry["classTitle"]) for entry in read_json(path)["objects"]}
        _written(self.target / "meta.json", format_meta(sorted(labels)))

    def _labelcloud_frame(self, frame: Frame) -> list[Path]:
        label = LabelCloudLabels(self.target).path(frame.key)
        paths = [write_cloud(label.parents[1] / "pointclouds" / f"{label.stem}.pcd", frame.cloud(self.cloud))]
        boxes = boxes_of(frame, self.boxes)
        if boxes is not None:
            cuboids = [replace(cuboid, track="", attributes={}) for cuboid in cuboids_of(boxes, "")]
            paths.append(_written(label, format_labelcloud(cuboids, paths[0].name)))
        label.parent.mkdir(parents=True, exist_ok=True)
        return paths

    def _xtreme1_frame(self, frame: Frame) -> list[Path]:
        label = Xtreme1Labels(self.target).path(frame.key)
        scene, stem = label.parents[1], label.stem
        paths = [write_cloud(scene / "lidar_point_cloud_0" / f"{stem}.pcd", frame.cloud(self.cloud))]
        cameras = [(name, camera) for name, camera in frame.cameras.items() if name in frame.images]
        for number, (name, _) in enumerate(cameras):
            paths.append(scene / f"camera_image_{number}" / f"{stem}.jpg")
            paths[-1].parent.mkdir(parents=True, exist_ok=True)
            write_image(paths[-1], frame.images[name])
        if cameras:
            rows = [(one.matrix, one.camera_T_lidar, one.width_px, one.height_px) for _, one in cameras]
            paths.append(_written(scene / "camera_config" / f"{stem}.json", format_cameras(rows)))
        boxes = boxes_of(frame, self.boxes)
        if boxes is not None:
            paths.append(_written(label, format_xtreme1(cuboids_of(boxes, stem, frame.annotation))))
        return paths


def write_cloud(path: Path, cloud: Cloud) -> Path:
    """Write a cloud as binary PCD with x, y, z and, where there is one, intensity."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = {axis: column.astype(np.float32) for axis, column in zip("xyz", cloud.points_m.T, strict=True)}
    if cloud.intensity is not None:
        fields["intensity"] = cloud.intensity.astype(np.float32)
    write_pcd(path, fields)
    return path


def _written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    return path
