"""Data sets written in the nuScenes schema: nuScenes' own tree, or T4's, one data set a scene.

Tokens are the first 32 hexadecimal digits of SHA-256 of table and key, so that two conversions are equal byte by byte.
The files of a frame are a unit of their own; the tables are written once all are there.
"""

import csv
import hashlib
import io
import json
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.datasets.labels.json_labels import file_name
from farfield.datasets.losses import Capacity, Loss
from farfield.datasets.nuscenes.clouds import FULL_INTENSITY
from farfield.datasets.tool_export import BoxSource, boxes_of, views
from farfield.errors import DatasetError
from farfield.files.atomic import open_atomic, write_bytes, write_text
from farfield.files.images import write_image
from farfield.files.pcd import format_header
from farfield.frame import Boxes, Cloud, Frame
from farfield.geometry.boxes import count_points_in_boxes
from farfield.geometry.poses import invert, pose_from_yaw, quaternion_from_rotation
from farfield.jobs import Unit, UnitResult
from farfield.vocabulary.classes import CIRRUS_FROM_NUSCENES, CIRRUS_FROM_T4

VERSION = "v1.0-farfield"
"""Name of the folder of nuScenes' tables."""
SchemaTarget = Literal["nuscenes", "t4"]
_RADAR_TYPES = {
    **dict.fromkeys(("x", "y", "z"), "<f4"),
    "dyn_prop": "<i1",
    "id": "<i2",
    **dict.fromkeys(("rcs", "vx", "vy", "vx_comp", "vy_comp"), "<f4"),
    **dict.fromkeys(("is_quality_valid", "ambig_state", "x_rms", "y_rms", "invalid_state", "pdh0"), "<i1"),
    **dict.fromkeys(("vx_rms", "vy_rms"), "<i1"),
}
_NEEDED = ("rcs", "vx", "vy", "vx_comp", "vy_comp")
_USUAL = {"dyn_prop": 4, "is_quality_valid": 1, "ambig_state": 3}  # unknown, valid, unambiguous
_CATEGORIES = {
    "vehicle": "vehicle.car",
    "large_vehicle": "vehicle.truck",
    "pedestrian": "human.pedestrian.adult",
    "bicycle": "vehicle.bicycle",
    "motorcycle": "vehicle.motorcycle",
    "wheeled_pedestrian": "human.pedestrian.personal_mobility",
    "trailer": "vehicle.trailer",
    "animal": "animal",
}
_VISIBILITIES = {"v0-40": "1", "v40-60": "2", "v60-80": "3", "v80-100": "4"}
_LEAST_UPRIGHT, _LEAST_LAG_S = 0.5, 1e-5
_FIRST_US, _STEP_US = 1_600_000_000_000_000, 500_000
_DETAILS = frozenset({"visibility", "attribute", "radar_points"})


def spelled_in_nuscenes(label: str) -> str:
    """The category of a class; one that has none keeps its name."""
    return _CATEGORIES.get(label, label)


def written_clouds(frame: Frame) -> tuple[str, ...]:
    """Clouds that the schema can hold: those of LiDARs with intensity, and of radars with all that their files need.

    Of a cloud that holds others, such as all LiDARs merged, these are written.
    """
    names: list[str] = []
    for name in frame.clouds:
        cloud: Cloud = frame.clouds[name]
        radar = all(column in cloud.extra for column in _NEEDED)
        if radar if cloud.intensity is None else True:
            names.append(name)
    merged = {name for name in names if name in frame.sensors and set(frame.sensors[name].holds) & set(names)}
    return tuple(name for name in names if name not in merged)


def is_lag_of_file(frame: Frame, name: str) -> bool:
    """Whether all points of a cloud are as old as its file's stamp tells: those of merged sweeps are not."""
    stamp_ns = frame.time_ns_of(name)
    lag_s = 0.0 if frame.time_ns is None or stamp_ns is None else (frame.time_ns - stamp_ns) * 1e-9
    return bool((np.abs(np.asarray(frame.clouds[name].extra["lag_s"]) - lag_s) < _LEAST_LAG_S).all())


_REASONS = {
    "names": "samples are named by tokens; frames.csv tells which is which",
    "columns": "lag_s is that of the file for all its points, as merged sweeps and times of points are not kept",
    "clouds": "a radar's needs rcs, vx, vy, vx_comp, vy_comp of each point; of merged clouds the parts are written",
    "images": "only those of calibrated cameras",
    "cameras": "only those with an image",
    "attributes": "tokens are made anew",
    "velocities": "they are read again as the way to the neighbouring samples over the time",
    "distortion": "rectify the images beforehand",
}
_HOLDS = frozenset({"times", "sensor times", "poses", "mounting", "tracks", "point counts", "empty frames"})
NUSCENES_HOLDS = Capacity(
    title="nuScenes' tree",
    read_by="nuscenes",
    holds=_HOLDS,
    chosen=written_clouds,
    columns=frozenset({"ring", "vz", "vz_comp", "doppler_m_s", *_RADAR_TYPES}),
    columns_if={"lag_s": is_lag_of_file},
    pictures="calibrated",
    attributes=_DETAILS,
    spelled=spelled_in_nuscenes,
    originals=frozenset(CIRRUS_FROM_NUSCENES),
    aliases=CIRRUS_FROM_NUSCENES,
    file_names=None,
    jpeg=True,
    reasons=_REASONS,
)
T4_HOLDS = Capacity(
    title="T4's data sets",
    words="nuscenes --dialect t4",
    read_by="t4",
    holds=_HOLDS | {"velocities", "distortion"},
    chosen=written_clouds,
    columns=NUSCENES_HOLDS.columns,
    columns_if={"lag_s": is_lag_of_file},
    pictures="calibrated",
    attributes=_DETAILS,
    spelled=spelled_in_nuscenes,
    originals=frozenset(CIRRUS_FROM_T4),
    aliases=CIRRUS_FROM_T4,
    file_names=None,
    jpeg=True,
    reasons=_REASONS,
)


def token_of(table: str, *key: object) -> str:
    """The token of a record: digits of a hash of its table and key."""
    text = "\0".join([table, *map(str, key)])
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:32]


@dataclass(eq=False)
class _Rows:
    """The records of one data set's tables."""

    tables: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)

    def add(self, table: str, token: str, **columns: Any) -> str:
        """Add a record unless its token is there."""
        self.tables.setdefault(table, {}).setdefault(token, {"token": token, **columns})
        return token


@dataclass(frozen=True, kw_only=True)
class SchemaExport:
    """Writes frames in the nuScenes schema; a unit's parameters are the frame's index.

    Args:
        dataset: The frames.
        target: Folder to write into.
        boxes: Which boxes to label.
        to: The dialect.
    """

    dataset: Dataset
    target: Path
    boxes: BoxSource
    to: SchemaTarget
    memory_bytes: ClassVar[int] = 500_000_000

    @property
    def setting(self) -> str:
        """What decides the files besides their sources."""
        return f"{self.to} {self.boxes} {self.dataset.name}{views(self.dataset)}"

    @cached_property
    def indices(self) -> list[int]:
        """The frames that are written: all, or those that were annotated where only some were."""
        annotated = [index for index in range(len(self.dataset)) if self.dataset.has_annotation(index)]
        return annotated or list(range(len(self.dataset)))

    def left_out(self) -> list[Loss]:
        """What of the set as a whole is not written as it is: frames without annotation, poses that are not known."""
        title = (NUSCENES_HOLDS if self.to == "nuscenes" else T4_HOLDS).title
        missing = len(self.dataset) - len(self.indices)
        lost = []
        if missing:
            reason = f"{missing} of {len(self.dataset)}: every sample there counts as annotated"
            lost.append(Loss(item="frames without annotation", title=title, reason=reason))
        if any(drive.world_T_frame is None for drive in self.dataset.drives()):
            reason = "poses are not known: the car is written as standing still, and velocities are relative to it"
            lost.append(Loss(item="the car's motion", title=title, reason=reason))
        if any(len(rows) == 1 and "/".join(self.dataset.keys[rows[0]]) == name for name, rows in self.scenes.items()):
            reason = "frames of no drive are a scene each, and no track goes from one scene to another"
            lost.append(Loss(item="tracks", title=title, reason=reason))
        return lost

    @cached_property
    def scenes(self) -> dict[str, list[int]]:
        """Frames by scene, in the order of time; those of no drive are a scene each."""
        written = set(self.indices)
        scenes = {
            name: [int(index) for index in rows if int(index) in written]
            for name, rows in self.dataset.drive_indices().items()
        }
        in_drives = {index for rows in scenes.values() for index in rows}
        scenes |= {"/".join(self.dataset.keys[index]): [index] for index in self.indices if index not in in_drives}
        return {name: rows for name, rows in scenes.items() if rows}

    @cached_property
    def scene_of(self) -> dict[int, tuple[str, int]]:
        """Scene of each frame, and its position in it."""
        return {index: (name, position) for name, rows in self.scenes.items() for position, index in enumerate(rows)}

    def units(self) -> list[Unit]:
        """One a frame."""
        keys = self.dataset.keys
        return [Unit("/".join(keys[index]), tuple(self.dataset.files(index)), index) for index in self.indices]

    def root_of(self, scene: str) -> Path:
        """The folder of a scene's data set: T4 has one a scene."""
        return self.target if self.to == "nuscenes" else self.target / file_name(scene)

    def __call__(self, unit: Unit) -> UnitResult:
        """Write the clouds and images of a frame."""
        frame = self.dataset[unit.parameters]
        root = self.root_of(self.scene_of[unit.parameters][0])
        paths = []
        for name, channel in self.channels(frame).items():
            path = root / self.file_of(unit.parameters, frame, name, channel)
            path.parent.mkdir(parents=True, exist_ok=True)
            if channel.startswith("CAM"):
                write_image(path, frame.images[name])
            elif channel.startswith("RADAR"):
                _write_radar(path, frame.clouds[name], _motion(frame, name))
            else:
                _write_lidar(path, frame.clouds[name], _motion(frame, name))
            paths.append(path)
        return UnitResult(files=tuple(paths))

    def channels(self, frame: Frame) -> dict[str, str]:
        """Channel of each cloud and calibrated image that is written; the first LiDAR is the top one.

        Raises:
            DatasetError: If two names become one channel.
        """
        clouds = written_clouds(frame)
        lidars = [name for name in clouds if frame.clouds[name].intensity is not None]
        leading = [name for name in lidars if _channel("LIDAR", name) == "LIDAR_TOP"] or lidars[:1]
        top = "" if "LIDAR_TOP" in lidars else next(iter(leading), "")
        channels = {top: "LIDAR_TOP"} if top else {}
        for name in clouds:
            channels.setdefault(name, _channel("LIDAR" if name in lidars else "RADAR", name))
        channels |= {name: _channel("CAM", name) for name in frame.cameras if name in frame.images}
        twins = [name for name, channel in channels.items() if list(channels.values()).count(channel) > 1]
        if twins:
            raise DatasetError(f"frame {frame.key}: expected names that differ as channels, got {', '.join(twins)}")
        return channels

    def file_of(self, index: int, frame: Frame, name: str, channel: str) -> str:
        """Where a file stands below its data set's folder."""
        suffix = "jpg" if channel.startswith("CAM") else "pcd" if channel.startswith("RADAR") else "pcd.bin"
        scene, position = self.scene_of[index]
        if self.to == "t4":
            return PurePosixPath("data", channel, f"{position:05d}.{suffix}").as_posix()
        stem = f"{file_name(scene)}__{channel}__{self.time_us(index, frame, name)}"
        return PurePosixPath("samples", channel, f"{stem}.{suffix}").as_posix()

    def time_us(self, index: int, frame: Frame, name: str | None = None) -> int:
        """Time of a frame or one of its sensors; made up, half a second apart, where frames have none."""
        if frame.time_ns is None:
            return _FIRST_US + index * _STEP_US
        time_ns = frame.time_ns if name is None else frame.time_ns_of(name)
        return ((frame.time_ns if time_ns is None else time_ns) + 500) // 1000

    def finish(self) -> None:
        """Write the tables, of T4 a set a scene.

        Raises:
            DatasetError: If a scene's times do not rise, or a track is of two classes or twice in a frame.
        """
        all_rows = _Rows()
        self._write_names()
        for scene, indices in self.scenes.items():
            rows = all_rows if self.to == "nuscenes" else _Rows()
            self._scene(rows, scene, indices)
            if self.to == "t4":
                self._write(rows, self.root_of(scene) / "annotation", [scene])
        if self.to == "nuscenes":
            self._write(all_rows, self.target / VERSION, list(self.scenes))

    def _write_names(self) -> None:
        """Which frame of the source became which sample."""
        table = io.StringIO()
        keys = self.dataset.keys
        rows = [
            (*keys[index], scene, self._sample(scene, index)) for scene, rows in self.scenes.items() for index in rows
        ]
        csv.writer(table, lineterminator="\n").writerows([("sequence", "frame", "scene", "sample_token"), *rows])
        write_text(self.target / "frames.csv", table.getvalue())

    def _sample(self, scene: str, index: int) -> str:
        return token_of("sample", scene, *self.dataset.keys[index])

    def _write(self, rows: _Rows, folder: Path, scenes: Sequence[str]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        logs = list(rows.tables.get("log", {}))
        picture = "maps/none.png" if self.to == "nuscenes" else ""
        if picture:
            (self.target / "maps").mkdir(exist_ok=True)
            write_bytes(self.target / picture, _grey_png())
        map_row = {"category": "semantic_prior", "filename": picture, "log_tokens": logs}
        rows.add("map", token_of("map", *scenes), **map_row)
        for level, token in _VISIBILITIES.items() if self.to == "nuscenes" else ():
            rows.add("visibility", token, level=level, description="")
        for table in _TABLES:
            records = list(rows.tables.get(table, {}).values())
            if table not in _IN_ORDER:
                records.sort(key=lambda record: record.get("name") or record["token"])
            write_text(folder / f"{table}.json", json.dumps(records, indent=0, ensure_ascii=False) + "\n")
        if self.to == "nuscenes":
            write_text(folder / "splits.json", json.dumps({"all": list(scenes)}, ensure_ascii=False) + "\n")

    def _scene(self, rows: _Rows, scene: str, indices: list[int]) -> None:
        keys = self.dataset.keys
        samples = [self._sample(scene, index) for index in indices]
        times, posed = list[int](), True
        for index in indices:  # a frame keeps what was read of it: none is kept
            frame = self.dataset[index]
            times.append(self.time_us(index, frame))
            posed &= frame.world_T_frame is not None
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise DatasetError(f"{self.dataset.root}: expected times that rise by a microsecond or more in {scene}")
        captured = datetime.fromtimestamp(times[0] / 1e6, UTC).strftime("%Y-%m-%d")
        date = {"date_captured": captured} if self.to == "nuscenes" else {"data_captured": captured}
        log = rows.add("log", token_of("log", scene), logfile=scene, vehicle="", location="", **date)
        rows.add(
            "scene",
            token_of("scene", scene),
            log_token=log,
            name=scene,
            description="" if posed else "Poses are not known: the car is written as standing still",
            nbr_samples=len(samples),
            first_sample_token=samples[0],
            last_sample_token=samples[-1],
        )
        data: dict[str, list[dict[str, Any]]] = {}
        objects: dict[str, list[dict[str, Any]]] = {}
        for position, index in enumerate(indices):
            frame = self.dataset[index]
            links = {"prev": samples[position - 1] if position else "", "next": (*samples, "")[position + 1]}
            rows.add(
                "sample", samples[position], timestamp=times[position], scene_token=token_of("scene", scene), **links
            )
            world = frame.world_T_frame if posed and frame.world_T_frame is not None else np.eye(4)
            ego = rows.add(
                "ego_pose", token_of("ego_pose", scene, *keys[index]), timestamp=times[position], **_placed(world)
            )
            for name, channel in self.channels(frame).items():
                record = self._sensor_rows(rows, index, frame, name, channel)
                data.setdefault(channel, []).append(record | {"sample_token": samples[position], "ego_pose_token": ego})
            self._annotate(rows, objects, scene, frame, world, samples[position])
        _chain(rows, "sample_data", data)
        _chain(rows, "sample_annotation", objects)
        for instance, records in objects.items():
            ends = {"first_annotation_token": records[0]["token"], "last_annotation_token": records[-1]["token"]}
            category = records[0].pop("_category")
            row = {"category_token": category, "nbr_annotations": len(records), **ends}
            rows.add("instance", instance, **(row if self.to == "nuscenes" else {"instance_name": "", **row}))

    def _sensor_rows(self, rows: _Rows, index: int, frame: Frame, name: str, channel: str) -> dict[str, Any]:
        kind = {"L": "lidar", "R": "radar", "C": "camera"}[channel[0]]
        sensor = rows.add("sensor", token_of("sensor", channel), channel=channel, modality=kind)
        motion = _motion(frame, name)
        camera = frame.cameras[name] if kind == "camera" else None
        intrinsic = [] if camera is None else camera.matrix.tolist()
        lens: dict[str, Any] = {}
        if self.to == "t4":
            lens = {"camera_distortion": [] if camera is None else camera.distortion.tolist()}
        key = hashlib.sha256(np.round(motion, 12).tobytes() + json.dumps([intrinsic, lens]).encode()).hexdigest()
        calibrated = rows.add(
            "calibrated_sensor",
            token_of("calibrated_sensor", channel, key),
            sensor_token=sensor,
            **_placed(motion),
            camera_intrinsic=intrinsic,
            **lens,
        )
        height, width = frame.images[name].shape[:2] if kind == "camera" else (0, 0)
        file = self.file_of(index, frame, name, channel)
        record = {
            "token": token_of("sample_data", *self.dataset.keys[index], channel),
            "calibrated_sensor_token": calibrated,
            "filename": file,
            "fileformat": {"lidar": "pcd", "radar": "pcd", "camera": "jpg"}[kind],
            "width": int(width),
            "height": int(height),
            "timestamp": self.time_us(index, frame, name),
            "is_key_frame": True,
        }
        return record if self.to == "nuscenes" else {**record, "is_valid": True}

    def _annotate(
        self,
        rows: _Rows,
        objects: dict[str, list[dict[str, Any]]],
        scene: str,
        frame: Frame,
        world_T_frame: Float[np.ndarray, "4 4"],
        sample: str,
    ) -> None:
        boxes, annotation = boxes_of(frame, self.boxes), frame.annotation
        if boxes is None or annotation is None:
            return
        counts = self._counts(frame, boxes)
        labels = np.asarray(boxes.label).tolist()
        original = labels if annotation.original_label is None else [str(name) for name in annotation.original_label]
        details = {name: np.asarray(annotation.details[name]) for name in _DETAILS if name in annotation.details}
        centre_m = boxes.centre_m @ world_T_frame[:3, :3].T + world_T_frame[:3, 3]
        velocity = None if boxes.velocity_m_s is None else _in_world(boxes.velocity_m_s, world_T_frame)
        tracks = [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()
        for row, (label, track) in enumerate(zip(labels, tracks, strict=True)):
            own = str(row) if track < 0 else ""
            instance = token_of("instance", scene, track, *((*frame.key, own) if own else ()))
            records = objects.setdefault(instance, [])
            category = _category(rows, self.to, label, original[row])
            if records and (records[0]["_category"] != category or records[-1]["sample_token"] == sample):
                raise DatasetError(
                    f"frame {frame.key}: expected a track once in a frame and of one class, got track {track} again, "
                    f"as {label}. Give it another track, or one class."
                )
            turn = pose_from_yaw(_upright(world_T_frame, float(boxes.yaw_rad[row])))[:3, :3]
            record: dict[str, Any] = {
                "token": token_of("sample_annotation", sample, instance),
                "sample_token": sample,
                "instance_token": instance,
                "visibility_token": _visibility(rows, details, row),
                "attribute_tokens": _attributes(rows, details, row),
                "translation": centre_m[row].tolist(),
                "size": boxes.size_m[row, [1, 0, 2]].tolist(),
                "rotation": quaternion_from_rotation(turn)[[3, 0, 1, 2]].tolist(),
                "num_lidar_pts": int(counts[row]),
                "num_radar_pts": int(details["radar_points"][row]) if "radar_points" in details else 0,
            }
            if self.to == "t4":
                has_velocity = velocity is not None and np.isfinite(velocity[row]).all()
                record["velocity"] = velocity[row].tolist() if has_velocity and velocity is not None else None
                record["acceleration"] = None
            if not records:
                record["_category"] = category
            records.append(record)

    def _counts(self, frame: Frame, boxes: Boxes) -> Sequence[int]:
        """LiDAR points in each box, as annotated, or counted in the first cloud where one is not known."""
        official = boxes.point_count
        if official is not None and (official >= 0).all():
            return [int(count) for count in official]
        lidars = [name for name in frame.clouds if frame.clouds[name].intensity is not None]
        counted = [0] * len(boxes)
        if lidars and (name := lidars[0]) in frame.sensors and frame.sensors[name].in_frame:
            counted = count_points_in_boxes(frame.clouds[name].points_m, boxes).tolist()
        return counted if official is None else [c if k < 0 else int(k) for c, k in zip(counted, official, strict=True)]


_TABLES = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)
_IN_ORDER = ("ego_pose", "sample", "sample_data", "sample_annotation", "scene", "log", "instance")


def _channel(kind: str, name: str) -> str:
    word = re.sub(r"[^A-Z0-9_]", "_", name.upper())
    starts = word.startswith(f"{kind}_") or (kind == "CAM" and word.startswith("CAMERA_"))
    return word if starts else f"{kind}_{word}"


def _motion(frame: Frame, name: str) -> Float[np.ndarray, "4 4"]:
    """Where a sensor stands in the frame; at its origin where that is not known."""
    if name in frame.cameras:
        return invert(frame.cameras[name].camera_T_lidar)
    sensor = frame.sensors.get(name)
    return np.eye(4) if sensor is None or sensor.frame_T_sensor is None else sensor.frame_T_sensor


def _own_axes(frame_points_m: Float[np.ndarray, "n 3"], motion: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3"]:
    back = invert(motion)
    return frame_points_m.astype(np.float64) @ back[:3, :3].T + back[:3, 3]


def _write_lidar(path: Path, cloud: Cloud, motion: Float[np.ndarray, "4 4"]) -> None:
    """Points of five float32 numbers: where they are in the sensor's axes, intensity to 255, ring or -1."""
    assert cloud.intensity is not None
    ring = cloud.extra.get("ring", np.full(len(cloud), -1))
    columns = [_own_axes(cloud.points_m, motion), cloud.intensity * np.float32(FULL_INTENSITY), ring]
    with open_atomic(path) as handle:
        handle.write(np.column_stack(columns).astype("<f4").tobytes())


def _write_radar(path: Path, cloud: Cloud, motion: Float[np.ndarray, "4 4"]) -> None:
    """Forty-three bytes a point and one more at the end, as the set's own files have; NaN is an empty sweep."""
    columns = dict(zip("xyz", _own_axes(cloud.points_m, motion).T, strict=True))
    for x, y, z in (("vx", "vy", "vz"), ("vx_comp", "vy_comp", "vz_comp")):
        vector = np.column_stack([cloud.extra[x], cloud.extra[y], cloud.extra.get(z, np.zeros(len(cloud)))])
        columns |= dict(zip((x, y), (vector.astype(np.float64) @ motion[:3, :3]).T[:2], strict=True))
    columns["rcs"] = cloud.extra["rcs"]
    usual = {name: cloud.extra.get(name, np.full(len(cloud), _USUAL.get(name, 0))) for name in _RADAR_TYPES}
    columns = {name: np.asarray(columns.get(name, usual[name])) for name in _RADAR_TYPES}
    if not len(cloud):
        columns = {name: np.array([np.nan if kind == "<f4" else 0]) for name, kind in _RADAR_TYPES.items()}
    typed = {name: columns[name].astype(kind) for name, kind in _RADAR_TYPES.items()}
    header = format_header(typed, len(typed["x"]), "binary")
    body = np.concatenate([column[:, None].view(np.uint8) for column in typed.values()], axis=1)
    with open_atomic(path) as handle:
        handle.write(header + body.tobytes() + b"\n")


def _placed(pose: Float[np.ndarray, "4 4"]) -> dict[str, list[float]]:
    quaternion = quaternion_from_rotation(pose[:3, :3])[[3, 0, 1, 2]]
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion.tolist()}


def _upright(world_T_frame: Float[np.ndarray, "4 4"], yaw_rad: float) -> float:
    """Yaw of the box that stands upright in the world and whose heading is seen from the frame under a yaw."""
    seen_from_frame = world_T_frame[:2, :2].T  # of level headings in the world, as the reader sees them
    if np.linalg.det(seen_from_frame) < _LEAST_UPRIGHT:
        raise DatasetError(f"expected a car that stands upright, got the pose {np.round(world_T_frame, 3).tolist()}")
    heading = np.linalg.solve(seen_from_frame, [np.cos(yaw_rad), np.sin(yaw_rad)])
    return float(np.arctan2(heading[1], heading[0]))


def _in_world(velocity_m_s: Float[np.ndarray, "n axes"], world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3"]:
    whole = np.zeros((len(velocity_m_s), 3))
    whole[:, : velocity_m_s.shape[1]] = velocity_m_s
    return whole @ world[:3, :3].T


def _chain(rows: _Rows, table: str, chains: Mapping[str, list[dict[str, Any]]]) -> None:
    """Add records with the tokens of those before and after them in their chain."""
    for records in chains.values():
        names = ["", *(record["token"] for record in records), ""]
        for position, record in enumerate(records):
            columns = {name: value for name, value in record.items() if name not in ("token", "_category")}
            rows.add(table, record["token"], **columns, prev=names[position], next=names[position + 2])


def _category(rows: _Rows, to: str, label: str, original: str) -> str:
    categories = CIRRUS_FROM_NUSCENES if to == "nuscenes" else CIRRUS_FROM_T4
    name = original if original in categories else spelled_in_nuscenes(label)
    return rows.add("category", token_of("category", name), name=name, description="")


def _visibility(rows: _Rows, details: Mapping[str, np.ndarray], row: int) -> str:
    level = str(details["visibility"][row]) if "visibility" in details else ""
    return rows.add("visibility", _level_token(level), level=level, description="") if level else ""


def _level_token(level: str) -> str:
    return _VISIBILITIES.get(level) or token_of("visibility", level)


def _attributes(rows: _Rows, details: Mapping[str, np.ndarray], row: int) -> list[str]:
    names = str(details["attribute"][row]).split(",") if "attribute" in details else []
    return [rows.add("attribute", token_of("attribute", name), name=name, description="") for name in names if name]


def _grey_png() -> bytes:
    """A grey picture of one pixel as a map, without which the devkit does not load."""
    chunks = (b"IHDR" + struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0), b"IDAT" + zlib.compress(b"\0\x80"), b"IEND")
    body = b"".join(struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return b"\x89PNG\r\n\x1a\n" + body
