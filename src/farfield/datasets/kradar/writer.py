"""Write frames in the layout of K-Radar, so that simulated data travels every path that real data does.

Every frame also gets a record, ``<sequence>/frame_record/00033_00001.json``; the files of a whole sequence
(description, times, odometry, calibrations, splits) are made from these records, whichever process wrote
them in whatever order.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.datasets.kradar.labels import format_labels
from farfield.datasets.kradar.layout import (
    CAMERAS,
    COLUMNS,
    EYES,
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    RESOURCES,
    RIGHT_EYE,
    SEQUENCE_SPLIT,
    SPLIT_FOLDER,
    index_name,
    is_sequence,
    is_stem,
    label_stem,
    product_path,
)
from farfield.datasets.kradar.products import first_shot_ns, write_lidar, write_radar, write_stereo
from farfield.datasets.kradar.texts import (
    format_camera,
    format_odometry,
    format_radar_calibration,
    format_times,
)
from farfield.datasets.splits import assign_splits
from farfield.errors import ConfigError, DatasetError, FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.frame import Annotation, Boxes, Camera, Frame
from farfield.vocabulary.kradar import DESCRIPTION_ORDER, format_description

VERSIONS = ("v1.0", "v2.1")


class KRadarWriter:
    """Write K-Radar: radar products, LiDAR sweeps, stereo images, annotations; the same bytes for the same frame.

    A frame's coordinates are the os2-64's: x forward, y left, z up. It brings what there is of

    - ``sequence``: a number from 1 to 999 without zeros before it; ``conditions``: ``road``, ``time``, ``weather``;
    - ``indices``: index of ``radar`` and ``os2-64``, and of ``cam-front``, ``os1-128`` and ``cam-lrr`` (the
      other three cameras) where there are such files;
    - clouds ``os2-64`` and ``os1-128``, the latter on its own sensor's axes, which its ``frame_T_sensor`` places; their
      columns are described at :func:`~farfield.datasets.kradar.products.write_lidar`;
    - radar products ``tesseract``, ``cube``, ``polar3d``, ``sparse``, ``cells`` in the radar's frame, described at
      :func:`~farfield.datasets.kradar.products.write_radar`;
    - images ``cam-front`` (left eye) and ``cam-front-right``, likewise ``cam-left``, ``cam-right`` and ``cam-rear``,
      and cameras of the same names;
    - an annotation: full boxes, with ``visibility`` (``R``, ``L`` or ``L1`` of each); ``time_ns``, ``world_T_frame``.

    A frame is complete when its record (``<sequence>/frame_record``) is there: it goes last. :meth:`finish` then writes
    the files of whole sequences.

    Args:
        root: Folder of the data set; made when a frame is written.
        labels: Versions of the annotations to write.
        tesseract_dtype: Dtype of the ``.mat`` arrays, tesseract and cube: ``"float32"``, or ``"float64"`` as in the
            real files, which are twice as large.
        compress: Pack the ``.mat`` files: smaller and much slower.
        columns: Columns of the LiDARs' grids.

    Raises:
        ConfigError: If an argument is not one of those possible.
    """

    def __init__(
        self,
        root: Path | str,
        labels: tuple[str, ...] = VERSIONS,
        tesseract_dtype: str = "float32",
        compress: bool = False,
        columns: int = COLUMNS,
    ) -> None:
        if not set(labels) <= set(VERSIONS):
            raise ConfigError(f"KRadarWriter: expected labels from {', '.join(VERSIONS)}; got {labels!r}")
        if tesseract_dtype not in ("float32", "float64"):
            raise ConfigError(f"KRadarWriter: expected tesseract_dtype float32 or float64, got {tesseract_dtype!r}")
        self.root = Path(root)
        self.labels, self.tesseract_dtype, self.compress, self.columns = labels, tesseract_dtype, compress, columns

    def paths(self, frame: Frame) -> dict[str, Path]:
        """Name the files of a frame by product, in the order in which they are written; nothing is loaded.

        Keys are the names of radar products, clouds and (left) images, ``label_v1.0``, ``label_v2.1`` and ``record``.

        Raises:
            DatasetError: If the sequence is no number, or an index or the time is missing.
        """
        indices, _ = self._indices(frame), self._time_ns(frame)
        products = [name for name in RADAR_PRODUCTS if name in frame.radar]
        products += [name for name in LIDARS if name in frame.clouds]
        products += [name for name in CAMERAS if name in frame.images or name + RIGHT_EYE in frame.images]
        files: dict[str, Path] = {}
        for product in products:
            index = indices.get(index_name(product))
            if index is None:
                missing = f"indices[{index_name(product)!r}], which numbers its {product} file"
                raise DatasetError(f"frame {frame.key}: expected {missing}")
            files[product] = self.root / product_path(product, frame.sequence, index)
        stem = label_stem(indices["radar"], indices["os2-64"])
        if frame.has_annotation:
            folders = {version: LABEL_TREES[version][0].format(seq=frame.sequence) for version in self.labels}
            files |= {f"label_{version}": self.root / folder / f"{stem}.txt" for version, folder in folders.items()}
        return files | {"record": self.root / record_path(frame.sequence, stem)}

    def write(self, frame: Frame) -> dict[str, Path]:
        """Write one frame, every file whole or not at all, the annotations and the record last.

        Returns:
            The files by product, as :meth:`paths` names them.

        Raises:
            DatasetError: If the frame lacks what names its files, or a product has another shape.
        """
        paths = self.paths(frame)
        for product, path in paths.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._write_one(frame, product, path)
        return paths

    def finish(self) -> list[Path]:
        """Write the files of whole sequences, from the records of all frames that stand in the root.

        That is description.txt, info_calib, time_info, camera calibrations, odometry, K-Radar's train and test lists,
        and a split that keeps sequences whole. Call it once, when all frames are written.

        Returns:
            The files written.
        """
        return write_sequence_files(self.root)

    def _write_one(self, frame: Frame, product: str, path: Path) -> None:
        if product in RADAR_PRODUCTS:
            options: dict[str, Any] = {"dtype": self.tesseract_dtype, "compress": self.compress}
            values = frame.radar[product]
            write_radar(path, product, values if product == "cells" else np.asarray(values), **options)
        elif product in LIDARS:
            write_lidar(path, frame.clouds[product], lines=LIDARS[product], columns=self.columns)
        elif product in CAMERAS:
            write_stereo(path, *(frame.images.get(name) for name in (product, product + RIGHT_EYE)))
        elif product == "record":
            write_record(path, FrameRecord.of(frame, self._indices(frame), self._time_ns(frame)))
        else:
            write_text(path, self._labels(frame, product.removeprefix("label_")))

    def _labels(self, frame: Frame, version: str) -> str:
        annotation = frame.annotation or Annotation(boxes=Boxes.empty())
        boxes, availability = annotation.boxes, list(annotation.visibility or ())
        if not set(availability) <= {"R", "L", "L1"}:
            actual = ", ".join(sorted(set(availability)))
            raise DatasetError(f"frame {frame.key}: expected visibility R, L or L1 of each box, got {actual}")
        indices, time_ns = self._indices(frame), self._time_ns(frame)
        return format_labels(boxes, indices, time_ns, version=version, availability=availability)

    @staticmethod
    def _indices(frame: Frame) -> dict[str, int]:
        indices = frame.indices
        if not is_sequence(frame.sequence) or not {"radar", "os2-64"} <= set(indices):
            raise DatasetError(
                f"frame {frame.key}: expected a sequence such as '1' and indices with 'radar' and "
                "'os2-64', which name the files of K-Radar"
            )
        return {name: int(index) for name, index in indices.items()}

    @staticmethod
    def _time_ns(frame: Frame) -> int:
        time_ns = frame.time_ns_of("os2-64")
        if time_ns is None:
            raise DatasetError(f"frame {frame.key}: expected time_ns, which the annotation's header gives; got None")
        return time_ns


# What K-Radar's own files cannot hold of a frame: one JSON file a frame beside them, which other readers ignore.

_MAX_BYTES = 1 << 20
_TIMED = (*LIDARS, *CAMERAS, *RADAR_PRODUCTS, "radar")  # what has a file of its own, and the radar
Number = Annotated[float, Field(allow_inf_nan=False, gt=-1e12, lt=1e12)]
Whole = Annotated[int, Field(ge=-(1 << 62), le=1 << 62)]
Row = tuple[Number, Number, Number, Number]
Pose = tuple[Row, Row, Row, Row]


class CameraRecord(BaseModel):
    """One eye's calibration."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    matrix: tuple[tuple[Number, Number, Number], tuple[Number, Number, Number], tuple[Number, Number, Number]]
    distortion: tuple[Number, Number, Number, Number, Number]
    camera_T_lidar: Pose
    width_px: Whole = 0
    height_px: Whole = 0

    @classmethod
    def of(cls, camera: Camera) -> "CameraRecord":
        """Record a camera."""
        arrays = {"matrix": camera.matrix, "distortion": camera.distortion, "camera_T_lidar": camera.camera_T_lidar}
        sizes = {"width_px": camera.width_px, "height_px": camera.height_px}
        return cls.model_validate({name: array.tolist() for name, array in arrays.items()} | sizes)

    def camera(self) -> Camera:
        """The camera."""
        return Camera(
            matrix=np.array(self.matrix, dtype=np.float64),
            distortion=np.array(self.distortion, dtype=np.float64),
            camera_T_lidar=np.array(self.camera_T_lidar, dtype=np.float64),
            width_px=self.width_px,
            height_px=self.height_px,
        )


class FrameRecord(BaseModel):
    """One frame: its sensors' indices and times, conditions, and the poses of the os2-64 and the os1-128.

    ``first_shot_ns`` is what must be added to a LiDAR file's ``t`` to get ``time_ns`` again.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    sequence: str
    indices: dict[str, Whole]
    time_ns: Whole
    times_ns: dict[str, Whole] = {}
    conditions: dict[str, str] = {}
    first_shot_ns: dict[str, Whole] = {}
    world_T_lidar: Pose | None = None
    os2_T_os1: Pose | None = None
    cameras: dict[str, CameraRecord] = {}

    @classmethod
    def of(cls, frame: Frame, indices: dict[str, int], time_ns: int) -> "FrameRecord":
        """Record a frame."""
        os1 = frame.sensors.get("os1-128")
        poses = {"world_T_lidar": frame.world_T_frame, "os2_T_os1": None if os1 is None else os1.frame_T_sensor}
        times = {name: frame.sensors[name].time_ns for name in _TIMED if name in frame.sensors}
        return cls.model_validate(
            {
                "sequence": frame.sequence,
                "indices": dict(sorted(indices.items())),
                "time_ns": time_ns,
                "times_ns": {name: sensor_ns for name, sensor_ns in sorted(times.items()) if sensor_ns is not None},
                "first_shot_ns": {name: first_shot_ns(frame.clouds[name]) for name in LIDARS if name in frame.clouds},
                "conditions": dict(sorted(frame.conditions.items())),
                "cameras": {name: CameraRecord.of(frame.cameras[name]) for name in EYES if name in frame.cameras},
                **{name: None if pose is None else np.asarray(pose).tolist() for name, pose in poses.items()},
            }
        )

    def pose(self, name: str) -> Float[np.ndarray, "4 4"] | None:
        """``"world_T_lidar"`` or ``"os2_T_os1"``."""
        rows = getattr(self, name)
        return None if rows is None else np.array(rows, dtype=np.float64)

    @property
    def stem(self) -> str:
        """Name of the frame."""
        return label_stem(self.indices["radar"], self.indices["os2-64"])


def record_path(sequence: str, stem: str) -> Path:
    """File of a record, relative to the root."""
    return Path(sequence) / "frame_record" / f"{stem}.json"


def write_record(path: Path, record: FrameRecord) -> None:
    """Write a record, all or nothing."""
    write_text(path, json.dumps(record.model_dump(mode="json", exclude_none=True), indent=1) + "\n")


def read_record(path: Path) -> FrameRecord:
    """Read a record.

    Raises:
        FileFormatError: If the file is damaged.
    """
    try:
        record = FrameRecord.model_validate(plain_json(read_bytes(path, max_bytes=_MAX_BYTES)))
        missing = {"radar", "os2-64"} - set(record.indices)
        if missing:
            raise ValueError(f"no index of {sorted(missing)[0]}")
    except (ValidationError, ValueError) as error:
        raise FileFormatError(path, where="the record", expected="a frame's record", got=plain(error)) from error
    return record


# Files of a whole sequence and of the whole set: they depend on nothing but the records of the frames on disk, so the
# same frames give the same bytes, whichever processes wrote them and however often a run was broken off.

PARTS = ("train", "val", "test")


def read_records(root: Path) -> dict[str, list[FrameRecord]]:
    """Read all records below a root: by sequence in the order of their numbers, each in the order of its frames.

    Raises:
        FileFormatError: If a record is damaged.
    """
    records: dict[str, list[FrameRecord]] = {}
    folders = [folder for folder in root.iterdir() if is_sequence(folder.name)] if root.is_dir() else []
    for folder in sorted(folders, key=lambda folder: int(folder.name)):
        paths = sorted(path for path in folder.glob("frame_record/*.json") if is_stem(path.stem))
        if paths:
            records[folder.name] = [read_record(path) for path in paths]
    return records


def sequence_files(sequence: str, records: Sequence[FrameRecord]) -> dict[Path, str]:
    """Texts of one sequence by path relative to the root: description, calibrations, times, odometry."""
    first = records[0]
    texts = {
        Path(sequence, "info_calib", "calib_radar_lidar.txt"): format_radar_calibration(
            first.indices["radar"] - first.indices["os2-64"]
        )
    }
    if set(DESCRIPTION_ORDER) <= set(first.conditions):
        texts[Path(sequence, "description.txt")] = format_description(first.conditions)
    for sensor in (*LIDARS, *CAMERAS):
        times = _times(sequence, sensor, records)
        if times:
            texts[Path(sequence, "time_info", f"{sensor}.txt")] = format_times(times)
    for name, number in EYES.items():
        camera = next((record.cameras[name] for record in records if name in record.cameras), None)
        if camera is not None:
            texts[camera_path(sequence, number)] = format_camera(camera.camera(), number)
    poses = [record.pose("world_T_lidar") for record in records]
    present = [pose for pose in poses if pose is not None]
    if len(present) == len(records):
        texts[odometry_path(sequence)] = format_odometry(present)
    return texts


def camera_path(sequence: str, number: int) -> Path:
    """Calibration of one eye, relative to the root."""
    return RESOURCES / "cam_calib" / "calib_seq_v2" / f"seq_{int(sequence):02d}" / f"cam_{number}.yml"


def odometry_path(sequence: str) -> Path:
    """Poses of a sequence's labelled frames, relative to the root."""
    return RESOURCES / "odometry" / "gt" / f"gt_{int(sequence):02d}.txt"


def _times(sequence: str, sensor: str, records: Sequence[FrameRecord]) -> dict[str, int]:
    times: dict[str, int] = {}
    for record in records:
        times_ns = record.times_ns | ({} if "os2-64" in record.times_ns else {"os2-64": record.time_ns})
        if sensor in times_ns and index_name(sensor) in record.indices:
            times[product_path(sensor, sequence, record.indices[index_name(sensor)]).name] = times_ns[sensor]
    return times


def quarters(stems: Mapping[str, Sequence[str]]) -> dict[str, list[tuple[str, str]]]:
    """Cut sequences as K-Radar does: four runs of (nearly) equal length, train, test, train, test.

    Neighbouring runs are the same drive 0.1 s apart, so scores on such a test part come out too good.

    Args:
        stems: Frames of each sequence in order.

    Returns:
        (sequence, frame) of the parts ``train`` and ``test``.
    """
    parts: dict[str, list[tuple[str, str]]] = {"train": [], "test": []}
    for sequence, names in stems.items():
        for quarter in range(4):
            first, last = (len(names) * number // 4 for number in (quarter, quarter + 1))
            parts["test" if quarter % 2 else "train"] += [(sequence, name) for name in names[first:last]]
    return parts


def whole_sequences(frames: Mapping[str, int], weather: Mapping[str, str]) -> dict[str, list[str]]:
    """Deal whole sequences out to train, val and test, about 70, 15 and 15 per cent of the frames of every weather.

    A weather with two sequences has none in val, one with a single sequence is in train only. If a part stays empty,
    the weather is not looked at.

    Args:
        frames: How many frames each sequence has.
        weather: Weather of each sequence, where it is known.

    Returns:
        Sequences of each part, or nothing for fewer than three sequences.
    """
    if len(frames) < len(PARTS):
        return {}
    groups: dict[str, list[str]] = {}
    for sequence in frames:
        groups.setdefault(weather.get(sequence, ""), []).append(sequence)
    parts: dict[str, list[str]] = {part: [] for part in PARTS}
    for group in groups.values():
        if len(group) < len(PARTS):
            dealt = dict(zip(("train", "test"), ([name] for name in group), strict=False))
        else:
            dealt = assign_splits([name for name in group for _ in range(frames[name])], root=Path())
        for part, names in dealt.items():
            parts[part] += names
    if not all(parts.values()):
        parts = assign_splits([name for name, count in frames.items() for _ in range(count)], root=Path())
    return {part: sorted(names, key=int) for part, names in parts.items()}


def write_sequence_files(root: Path) -> list[Path]:
    """Write the files of all sequences that have records, and the splits; returns what was written.

    Raises:
        FileFormatError: If a record is damaged.
    """
    records = read_records(root)
    texts: dict[Path, str] = {}
    for sequence, frames in records.items():
        texts |= sequence_files(sequence, frames)
    if records:
        parts = quarters({sequence: [record.stem for record in frames] for sequence, frames in records.items()})
        for part, keys in parts.items():
            lines = [f"{sequence},{stem}.txt" for sequence, stem in keys]
            texts[SPLIT_FOLDER / f"{part}.txt"] = "\n".join(lines)
        weather = {name: frames[0].conditions.get("weather", "") for name, frames in records.items()}
        dealt = whole_sequences({name: len(frames) for name, frames in records.items()}, weather)
        if dealt:
            texts[SEQUENCE_SPLIT] = json.dumps(dealt, indent=1) + "\n"
    for path, text in texts.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        write_text(root / path, text)
    return [root / path for path in texts]
