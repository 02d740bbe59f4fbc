"""Argoverse 2's sensor logs (Wilson et al., NeurIPS Datasets 2021), in feather files; needs the extra ``argoverse2``.

``<log>/sensors/lidar/<time_ns>.feather``, ``annotations.feather``, ``calibration/*.feather``, ``city_SE3_egovehicle``.
A log of annotations alone opens too: its frames are the annotated stamps, without clouds.
Coordinates are the ego vehicle's: origin at the rear axle, some 0.3 m above the ground.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.errors import DatasetError, FileFormatError
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name
from farfield.files.feather import read_feather
from farfield.files.images import read_image
from farfield.files.limits import MAX_NAME
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import pattern_in_any_case
from farfield.frame import Annotation, Boxes, Camera, Cloud, Constant, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import invert, pose, rotation_from_quaternion, yaw_from_quaternion
from farfield.vocabulary.classes import CIRRUS_FROM_ARGOVERSE2, normalised_class

_QUATERNION = ("qx", "qy", "qz", "qw")
_TRANSLATION = ("tx_m", "ty_m", "tz_m")
_SIZE = ("length_m", "width_m", "height_m")
_TEXTS, _WHOLE = ("track_uuid", "category", "sensor_name"), ("timestamp_ns", "num_interior_pts")
_IMAGE_WITHIN_NS = 100_000_000

Table = dict[str, np.ndarray]


def read_columns(path: Path, names: Sequence[str]) -> Table:
    """Read columns of one of the data set's feather files.

    Raises:
        MissingExtraError: If pyarrow is not installed.
        FileFormatError: If the file is damaged, lacks a column, or holds anything but numbers in one that has numbers.
    """
    columns = read_feather(path, names)
    for name, values in columns.items():
        kind = "text" if name in _TEXTS else "whole numbers" if name in _WHOLE else "numbers"
        sound = kind != "text" or all(is_name(text) and len(text) <= MAX_NAME for text in set(values.tolist()))
        if not sound if kind == "text" else values.dtype.kind not in ("iu" if kind == "whole numbers" else "iuf"):
            raise FileFormatError(path, where=f"column {name}", expected=kind, got=str(values.dtype)[:80])
    return columns


class _Log:
    """One drive: its sweeps, annotations, cameras and poses, each read once."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.sweeps = sorted((p for p in root.glob(pattern_in_any_case(_SWEEPS)) if p.stem.isdigit()), key=_time)

    @cached_property
    def annotation_path(self) -> Path | None:
        """The file of annotations; scenario mining's holds the measuring car as a track of its own."""
        return next((path for name in _ANNOTATIONS if (path := self.root / name).is_file()), None)

    @cached_property
    def annotations(self) -> Table | None:
        path = self.annotation_path
        names = ("timestamp_ns", "track_uuid", "category", *_SIZE, *_QUATERNION, *_TRANSLATION, "num_interior_pts")
        if path is None:
            return None
        table = read_columns(path, names)
        others = table["category"].astype(str) != "EGO_VEHICLE"
        table = table if others.all() else {name: values[others] for name, values in table.items()}
        stamps = table["timestamp_ns"]
        if self.sweeps and len(stamps) and not np.isin(stamps, [_time(path) for path in self.sweeps]).any():
            raise DatasetError(
                f"{path}: expected timestamp_ns of the sweeps, such as {self.sweeps[0].stem}, found none, but others "
                f"such as {stamps[0]}. They may be of another log, or in another unit."
            )
        return table

    @cached_property
    def stamps(self) -> list[tuple[int, Path | None]]:
        """Times of the frames with their sweeps; those of the annotations where there is no sweep at all."""
        if self.sweeps:
            return [(_time(path), path) for path in self.sweeps]
        times = [] if self.annotations is None else np.unique(self.annotations["timestamp_ns"]).tolist()
        return [(int(time_ns), None) for time_ns in times]

    @cached_property
    def track_ids(self) -> dict[str, int]:
        assert self.annotations is not None
        return {name: number for number, name in enumerate(np.unique(self.annotations["track_uuid"].astype(str)))}

    def annotated(self, rows: Int[np.ndarray, " n"]) -> tuple[Path, str, Table]:
        """Where some rows of the annotations stand, and their columns with the tracks' numbers."""
        assert self.annotations is not None
        assert self.annotation_path is not None
        table = {name: values[rows] for name, values in self.annotations.items()}
        table["track_id"] = np.array([self.track_ids[str(name)] for name in table["track_uuid"]], dtype=np.int64)
        where = f"rows {rows[0]} to {rows[-1]}" if len(rows) else "no rows"
        return self.annotation_path, where, table

    @cached_property
    def poses(self) -> Table | None:
        path = self.root / "city_SE3_egovehicle.feather"
        return read_columns(path, ("timestamp_ns", *_QUATERNION, *_TRANSLATION)) if path.is_file() else None

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        folder = self.root / "calibration"
        if not (folder / "intrinsics.feather").is_file():
            return {}
        size = ("height_px", "width_px")
        lens = read_columns(folder / "intrinsics.feather", ("sensor_name", *_LENS, *size))
        mount = read_columns(folder / "egovehicle_SE3_sensor.feather", ("sensor_name", *_QUATERNION, *_TRANSLATION))
        row_of = {str(name): row for row, name in enumerate(mount["sensor_name"])}
        return {
            str(name): _camera(lens, row, _pose_at(mount, row_of[str(name)]))
            for row, name in enumerate(lens["sensor_name"])
            if str(name) in row_of
        }

    @cached_property
    def images(self) -> dict[str, list[Path]]:
        folders = sorted(path for path in self.root.glob("sensors/cameras/*") if path.is_dir())
        return {
            f.name: sorted((p for p in f.glob(pattern_in_any_case("*.jpg")) if p.stem.isdigit()), key=_time)
            for f in folders
        }


_LENS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3")


def _time(path: Path) -> int:
    return int(path.stem)


def _pose_at(table: Table, row: int) -> Float[np.ndarray, "4 4"]:
    quaternion = np.array([table[name][row] for name in _QUATERNION], dtype=np.float64)
    return pose(rotation_from_quaternion(quaternion), np.array([table[name][row] for name in _TRANSLATION]))


def _camera(lens: Table, row: int, ego_T_camera: Float[np.ndarray, "4 4"]) -> Camera:
    fx, fy, cx, cy, k1, k2, k3 = (float(lens[name][row]) for name in _LENS)
    return Camera(
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array([k1, k2, 0.0, 0.0, k3]),
        camera_T_lidar=invert(ego_T_camera),
        width_px=int(lens["width_px"][row]),
        height_px=int(lens["height_px"][row]),
    )


class Argoverse2(Dataset):
    """Argoverse 2 sweeps: cloud ``"lidar"`` in ego coordinates, cameras by name, boxes with official point counts.

    ``boxes.point_count`` is ``num_interior_pts``; the annotation's ``original_label`` are the categories. The cloud is
    that of two LiDARs on one mast, so it has no pose of its own.

    Args:
        root: One log, a folder of logs, or one with ``train``, ``val``, ``test``.
        classes: ``"cirrus"`` translates categories (published ones that are none of ours become ``unknown``),
            ``"argoverse2"`` keeps them.

    Raises:
        DatasetError: If there are neither sweeps nor annotations.
    """

    name = "argoverse2"

    def __init__(self, root: Path | str, *, classes: Literal["cirrus", "argoverse2"] = "cirrus") -> None:
        self.root, self.classes = as_path(root), classes
        prefixes = ("", "*/", "*/*/")
        folders = {
            path.parents[2] for prefix in prefixes for path in self.root.glob(pattern_in_any_case(f"{prefix}{_SWEEPS}"))
        }
        folders |= {
            path.parent for prefix in prefixes for name in _ANNOTATIONS for path in self.root.glob(prefix + name)
        }
        self.logs = [_Log(path) for path in sorted(folders)]
        self._index = [(log, time_ns, sweep) for log in self.logs for time_ns, sweep in log.stamps]
        if not self._index:
            expected = f"Argoverse 2 sweeps in <log>/{_SWEEPS}, or <log>/{_ANNOTATIONS[0]}"
            raise DatasetError(f"{self.root}: expected {expected}, found none")
        self.sequences = tuple(log.root.resolve().name for log, _, _ in self._index)
        self.frame_ids = tuple(str(time_ns) if sweep is None else sweep.stem for _, time_ns, sweep in self._index)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``; the annotations are shared by their log."""
        log, _, sweep = self._index[index]
        return [path for path in (sweep, log.annotation_path) if path is not None]

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._index[index][1] for index in indices)

    def _poses_of(self, indices: Indices) -> Poses | None:
        frames = (self._index[index] for index in indices)
        return all_poses(_pose_near(log, time_ns) for log, time_ns, _ in frames)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        log, time_ns, sweep = self._index[index]
        rows = None if log.annotations is None else np.flatnonzero(log.annotations["timestamp_ns"] == time_ns)
        images = {name: _nearest(paths, time_ns) for name, paths in log.images.items()}
        present = {name: path for name, path in images.items() if path is not None}
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            clouds=Lazy({} if sweep is None else {"lidar": partial(_read_sweep, sweep)}),
            images=Lazy({name: partial(read_image, path) for name, path in present.items()}),
            cameras=log.cameras,
            sensors={
                **({} if sweep is None else {"lidar": Sensor(kind="lidar", time_ns=time_ns)}),
                **{name: camera_sensor(camera) for name, camera in log.cameras.items()},
                **{name: camera_sensor(log.cameras.get(name), _time(path)) for name, path in present.items()},
            },
            load_annotation=None if rows is None else partial(_annotation, *log.annotated(rows), self.classes),
            world_T_frame=_pose_near(log, time_ns),
            reference="ego",
            metadata=Lazy({"files": Constant([str(path) for path in self.files(index)])}),
        )


_SWEEPS = "sensors/lidar/*.feather"
_ANNOTATIONS = ("annotations.feather", "annotations_with_ego.feather")


def _annotation(path: Path, where: str, table: Table, classes: str) -> Annotation:
    original = tuple(str(name) for name in table["category"])
    names = [normalised_class(name, CIRRUS_FROM_ARGOVERSE2) for name in original] if classes == "cirrus" else original
    quaternion = np.column_stack([table[name] for name in _QUATERNION]).astype(np.float64)
    numbers = np.column_stack([table[name] for name in (*_SIZE, *_QUATERNION, *_TRANSLATION)])
    try:
        if not (np.abs(numbers) <= FARTHEST_M).all():
            raise ValueError(f"numbers that are not finite or above {FARTHEST_M:g}")
        if (table["num_interior_pts"] < 0).any():
            raise ValueError("a negative num_interior_pts")
        if len(np.unique(table["track_id"])) < len(original):
            raise ValueError("a track twice at one time")
        check_turns(quaternion, path, f"{where}, box {{}}")
        boxes = Boxes(
            centre_m=np.column_stack([table[name] for name in _TRANSLATION]),
            size_m=np.column_stack([table[name] for name in _SIZE]),
            yaw_rad=yaw_from_quaternion(quaternion) if len(original) else np.zeros(0),
            label=list(names),
            track_id=table["track_id"],
            point_count=table["num_interior_pts"].astype(np.int64),
        )
    except ValueError as error:
        raise FileFormatError(path, where=where, expected="possible boxes", got=str(error)) from error
    return Annotation(boxes=boxes, original_label=original)


def _read_sweep(path: Path) -> Cloud:
    table = read_columns(path, ("x", "y", "z", "intensity", "laser_number", "offset_ns"))
    points = np.column_stack([table[axis] for axis in "xyz"]).astype(np.float32)
    valid = returned(path, points)
    table = {name: values[valid] for name, values in table.items()}
    strength = table["intensity"].astype(np.float32) / np.float32(255)
    if not ((strength >= 0) & (strength <= 1)).all():
        actual = f"{strength.min() * 255:g} to {strength.max() * 255:g}"
        raise FileFormatError(path, where="column intensity", expected="values from 0 to 255", got=actual)
    extra = {"ring": table["laser_number"], "offset_ns": table["offset_ns"]}
    return Cloud(points[valid], strength, extra, int((~valid).sum()))


def _nearest(paths: Sequence[Path], time_ns: int) -> Path | None:
    best = min(paths, key=lambda path: abs(_time(path) - time_ns), default=None)
    return best if best is not None and abs(_time(best) - time_ns) <= _IMAGE_WITHIN_NS else None


def _pose_near(log: _Log, time_ns: int) -> Float[np.ndarray, "4 4"] | None:
    """City pose of the ego vehicle at the sweep's time, or None where none lies within 0.1 s."""
    if log.poses is None or len(log.poses["timestamp_ns"]) == 0:
        return None
    gap_ns = np.abs(log.poses["timestamp_ns"] - time_ns)
    row = int(gap_ns.argmin())
    return _pose_at(log.poses, row) if gap_ns[row] <= _IMAGE_WITHIN_NS else None
