"""One's own clouds in one folder, with boxes in small JSON files beside them.

Clouds: ``.pcd``, ``.ply``, ``.bin`` (KITTI velodyne), ``.npy``, ``.npz``, ``.xyz``, ``.las``, ``.laz``, ``.ffcloud``; x
forward, y left, z up, metres. Coordinates of a map in LAS or LAZ lose an origin, which is said; tiles more than 10 km
from it lose one of their own, and the frames' poses say where they stand.
Boxes: ``<stem>.json`` beside the cloud or in ``boxes/`` or ``labels/``::

    {"boxes": [{"label": "vehicle", "centre_m": [x, y, z], "size_m": [l, w, h], "yaw_rad": 0.1,
                "score": 0.9, "track_id": 3, "velocity_m_s": [vx, vy, vz]}]}

``score``, ``track_id`` and ``velocity_m_s`` (over ground, in the box's axes as its centre is, with or without z) are
optional; unknown keys are errors. Or all boxes in one table, ``labels.csv`` in the folder, with the columns of
:mod:`farfield.files.boxes_csv`; ``sequence`` may be absent, else it is the folder's name. A frame without a line there
is not annotated: the JSON ``{"boxes": []}`` beside a cloud says that nothing is to be seen. A file ``mapping.yaml``
renames classes: ``classes: {Auto: vehicle}``; without a line there, usual names such as ``Car`` are mapped to ours.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.datasets.calibration import CALIBRATION_NAMES, usable_cameras
from farfield.datasets.class_mapping import MAPPING_NAME, read_class_mapping, renamed, usual
from farfield.datasets.cloud_reading import CloudReading
from farfield.errors import DatasetError, FileFormatError, plain
from farfield.files.atomic import read_bytes, readable, write_text
from farfield.files.boxes_csv import BoxRows, read_boxes_csv, zeros_note
from farfield.files.cuboids import check_yaw, is_name
from farfield.files.images import read_image
from farfield.files.json_text import parse_json, plain_json
from farfield.files.limits import MAX_NAME
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.stamps import name_time_ns
from farfield.files.suffixes import any_case, existing
from farfield.frame import Annotation, Boxes, Camera, Constant, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import CLOUD_SUFFIXES
from farfield.vocabulary.counts import count_of

TABLE_NAME = "labels.csv"
_BOX_FOLDERS = ("", "boxes", "labels")
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
_MAX_BYTES = 64 << 20


def _number(value: Any) -> Any:
    """A number as it stands: neither a text nor true or false, which would do as well."""
    if isinstance(value, bool | str):
        raise ValueError(f"expected a number, got {value!r}"[:80])
    return value


def _name(value: str) -> str:
    if not is_name(value):
        raise ValueError(f"expected a name on one line, got {value!r}"[:80])
    return value


_Finite = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
_Coordinate = Annotated[float, BeforeValidator(_number), Field(ge=-1e7, le=1e7, allow_inf_nan=False)]
_Positive = Annotated[float, BeforeValidator(_number), Field(gt=0, le=1e6, allow_inf_nan=False)]
_Angle = Annotated[float, BeforeValidator(_number), Field(ge=-1e3, le=1e3, allow_inf_nan=False)]
_Track = Annotated[int, BeforeValidator(_number), Field(ge=-1, lt=1 << 53)]


class _BoxEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")

    label: Annotated[str, Field(max_length=MAX_NAME), AfterValidator(_name)]
    centre_m: tuple[_Coordinate, _Coordinate, _Coordinate]
    size_m: tuple[_Positive, _Positive, _Positive]
    yaw_rad: _Angle
    score: _Finite | None = None
    track_id: _Track | None = None
    velocity_m_s: tuple[_Finite, _Finite] | tuple[_Finite, _Finite, _Finite] | None = None


class _BoxFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    boxes: list[_BoxEntry]


def read_boxes(path: Path | str) -> Boxes:
    """Read boxes from this module's JSON.

    Raises:
        FileFormatError: If the file does not hold such boxes.
    """
    data = read_bytes(path, max_bytes=_MAX_BYTES)
    try:
        entries = _BoxFile.model_validate(parse_json(data, path)).boxes
    except ValidationError as error:
        _refuse_labelcloud(path, data)
        raise FileFormatError(path, where="keys", expected="boxes", got=plain(error)) from error
    if not entries:
        return Boxes.empty()
    for number, entry in enumerate(entries):
        check_yaw(entry.yaw_rad, path, f"box {number}")
    scores = [entry.score for entry in entries]
    tracks = [-1 if entry.track_id is None else entry.track_id for entry in entries]
    if any(score is None for score in scores) and any(score is not None for score in scores):
        raise FileFormatError(path, where="boxes", expected="a score for all boxes or for none", got="some")
    return Boxes(
        centre_m=np.array([entry.centre_m for entry in entries]),
        size_m=np.array([entry.size_m for entry in entries]),
        yaw_rad=np.array([entry.yaw_rad for entry in entries]),
        label=[entry.label for entry in entries],
        score=None if scores[0] is None else np.array(scores, dtype=np.float64),
        track_id=None
        if all(t is None for t in tracks)
        else np.array([-1 if t is None else t for t in tracks], dtype=np.int64),
        velocity_m_s=_velocities(path, entries),
    )


def _refuse_labelcloud(path: Path | str, data: bytes) -> None:
    """Name labelCloud's JSON, whose boxes are called objects.

    Raises:
        FileFormatError: If it is such a file.
    """
    try:
        tree = plain_json(data)
    except ValueError:
        return
    objects = tree.get("objects") if isinstance(tree, dict) else None
    entries = objects if isinstance(objects, list) else []
    keys = {key for entry in entries if isinstance(entry, dict) for key in entry}
    if objects is None or not (keys & {"centroid", "vertices"} or "filename" in tree):
        return
    raise FileFormatError(
        path,
        where="key 'objects'",
        expected="boxes",
        got="labels of labelCloud",
        fix="Leave --format folder out, or open it with --format labelcloud.",
    )


def _velocities(path: Path | str, entries: Sequence[_BoxEntry]) -> Float[np.ndarray, "n axes"] | None:
    """Velocities of all boxes, NaN where one has none; None where none has one."""
    axes = {len(entry.velocity_m_s) for entry in entries if entry.velocity_m_s is not None}
    if not axes:
        return None
    if len(axes) > 1:
        expected = "as many numbers in every velocity_m_s"
        raise FileFormatError(path, where="boxes", expected=expected, got="velocities of two and of three")
    unknown = (np.nan,) * axes.pop()
    return np.array([unknown if entry.velocity_m_s is None else entry.velocity_m_s for entry in entries])


def write_boxes(path: Path | str, boxes: Boxes) -> None:
    """Write boxes as this module's JSON, whole or not at all."""
    columns = {
        "label": np.asarray(boxes.label).tolist(),
        "centre_m": boxes.centre_m.tolist(),
        "size_m": boxes.size_m.tolist(),
        "yaw_rad": boxes.yaw_rad.tolist(),
    }
    if boxes.score is not None:
        columns["score"] = boxes.score.tolist()
    if boxes.track_id is not None:
        columns["track_id"] = boxes.track_id.tolist()
    entries = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    for entry, velocity in zip(entries, [] if boxes.velocity_m_s is None else boxes.velocity_m_s, strict=False):
        if np.isfinite(velocity).all():  # what is not known is left out
            entry["velocity_m_s"] = velocity.tolist()
    write_text(path, json.dumps({"boxes": entries}, indent=1) + "\n")


def _read_annotation(path: Path, classes: Mapping[str, str]) -> Annotation:
    return renamed(usual(Annotation(boxes=read_boxes(path))), classes)


def cloud_files(root: Path) -> list[Path]:
    """The clouds of a folder in the order of their names, without hidden files such as macOS' ``._a.pcd``.

    Raises:
        DatasetError: If one is a link to what is not there: a frame would be missing without a word.
    """
    named = sorted(
        path for path in root.iterdir() if path.suffix.lower() in CLOUD_SUFFIXES and not path.name.startswith(".")
    )
    broken = [path for path in named if path.is_symlink() and not path.exists()]
    if broken:
        raise DatasetError(
            f"{broken[0]}: expected a cloud, found a link to {broken[0].readlink()}, which is not there or leads in a "
            f"circle ({len(broken)} of {count_of(len(named), 'cloud')} are "
            "such links). Copy what it stands for, or, in a "
            "repository of git-annex: git annex get ."
        )
    return [path for path in named if path.is_file()]


def boxes_of_table(rows: BoxRows, path: Path) -> Boxes:
    """The boxes of a table's rows.

    Raises:
        FileFormatError: If a heading is no angle in radians.
    """
    for row, yaw_rad in enumerate(rows.yaw_rad.tolist()):
        check_yaw(yaw_rad, path, f"box {row + 1}")
    return Boxes(
        centre_m=rows.centre_m,
        size_m=rows.size_m,
        yaw_rad=rows.yaw_rad,
        label=rows.label,
        score=rows.score,
        track_id=rows.track_id,
        point_count=rows.point_count,
        velocity_m_s=rows.velocity_m_s,
    )


def read_table(path: Path, sequence: str) -> dict[str, Boxes]:
    """The boxes of a sequence by frame, from a table of boxes.

    Args:
        path: The table.
        sequence: The sequence's name; a table without that column has one sequence.

    Raises:
        DatasetError: If it names sequences, and not this one.
        FileFormatError: If it is no such table.
    """
    rows = read_boxes_csv(path)
    boxes = boxes_of_table(rows, path)
    here = np.full(len(rows), True) if rows.sequence is None else rows.sequence == sequence
    if rows.sequence is not None and len(rows) and not here.any():
        there = ", ".join(map(repr, dict.fromkeys(rows.sequence.tolist())))[:120]
        raise DatasetError(
            f"{path}: expected boxes of the sequence {sequence!r}, which the clouds' folder is called, found those of "
            f"{there}. Rename the sequence or the folder, or leave the column out."
        )
    return {str(frame): boxes[here & (rows.frame == frame)] for frame in dict.fromkeys(rows.frame[here].tolist())}


class Folder(Dataset):
    """The clouds of one folder, one sequence named like the folder, each frame named by its file's stem.

    They are taken for a LiDAR's, whose pose is not known: these files have an intensity and no Doppler.

    Args:
        root: The folder.
        mapping: A file that renames classes; None takes ``mapping.yaml`` in the folder, if it is there.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        column_names: Names of the columns of all files that name none, such as ``("x", "y", "z", "time")``.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any: ``s``, ``ms``, ``us``, ``ns``, or ``none`` to
            leave the column as it is; ``auto`` decides by the sweeps' period.

    Raises:
        DatasetError: If there is no cloud, two clouds share a stem, a frame has two annotations, or the table none of
            these clouds.
        ConfigError: If the mapping is none.
        FileFormatError: If the table is damaged.
    """

    name = "folder"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        mapping: Path | str | None = None,
        bin_columns: int | None = None,
        column_names: Sequence[str] = (),
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.root = as_path(root)
        own = self.root / MAPPING_NAME
        self.mapping_path = as_path(mapping) if mapping is not None else own if own.is_file() else None
        self.class_mapping = {} if self.mapping_path is None else read_class_mapping(self.mapping_path)
        self.clouds = cloud_files(self.root)
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected clouds with suffix {', '.join(CLOUD_SUFFIXES)}; found none")
        self.frame_ids = tuple(readable(path.stem) for path in self.clouds)
        self.sequences = (readable(self.root.resolve().name),) * len(self.clouds)
        double = next((stem for stem, count in Counter(self.frame_ids).items() if count > 1), None)
        if double is not None:
            raise DatasetError(f"{self.root}: expected one cloud a stem, found several with stem {double!r}")
        self.reading = CloudReading(
            self.clouds,
            bin_columns=bin_columns,
            column_names=column_names,
            intensity_scale=intensity_scale,
            point_times=point_times,
            stamps_ns=[name_time_ns(stem) for stem in self.frame_ids],
            posed=True,
        )
        self.table_path = self.root / TABLE_NAME
        self._table = read_table(self.table_path, self.sequences[0]) if self.table_path.is_file() else {}
        self._check_table()

    def _check_table(self) -> None:
        """Each frame's annotation stands once, and a table is of these clouds."""
        if self._table and not set(self._table) & set(self.frame_ids):
            first = next(iter(self._table))
            with_suffix = {path.name for path in self.clouds} & set(self._table)
            fix = "Leave out the files' suffix." if with_suffix else "Name them as the clouds' files, without suffix."
            raise DatasetError(
                f"{self.table_path}: expected boxes of the clouds beside it, such as frame {self.frame_ids[0]!r}; its "
                f"frames are others, such as {first!r}. {fix} "
                f"{zeros_note(self._table, self.frame_ids)}".rstrip()
            )
        cloud_stems, stems = {path.stem for path in self.clouds}, [self._stems(folder) for folder in _BOX_FOLDERS]
        for row, folder in enumerate(_BOX_FOLDERS):
            twice = min((cloud_stems & stems[row]).intersection(*[set().union(*stems[row + 1 :])]), default=None)
            if twice is not None:
                raise DatasetError(
                    f"{self.root}: expected one annotation a frame, found two of {twice!r}: one in "
                    f"{folder or 'the folder itself'} and one in another of {', '.join(filter(None, _BOX_FOLDERS))}. "
                    "Remove one of them."
                )
        for index, stem in enumerate(self.frame_ids):
            beside = self._beside(index, _BOX_FOLDERS, [".json"]) if stem in self._table else None
            if beside is not None:
                raise DatasetError(
                    f"{self.root}: expected one annotation a frame, found boxes of {stem!r} in {beside.name} and in "
                    f"{TABLE_NAME}. Remove one of them."
                )

    def _stems(self, folder: str) -> set[str]:
        """Stems of the annotations in a folder."""
        path = self.root / folder
        return {path.stem for path in path.glob("*" + any_case(".json"))} if path.is_dir() else set()

    @property
    def strays(self) -> tuple[str, ...]:
        """Annotations of frames that have no cloud: files of boxes, and frames of the table."""
        stems = {path.stem for path in self.clouds}
        files = (f"{folder}/{stem}.json" for folder in _BOX_FOLDERS if folder for stem in self._stems(folder) - stems)
        return (*sorted(files), *(f"{TABLE_NAME}: {name}" for name in self._table if name not in self.frame_ids))

    def _beside(self, index: int, folders: Sequence[str], suffixes: Sequence[str]) -> Path | None:
        stem = self.clouds[index].stem
        candidates = (self.root / folder / f"{stem}{suffix}" for folder in folders for suffix in suffixes)
        return next((path for candidate in candidates if (path := existing(candidate))), None)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        beside = (self._beside(index, _BOX_FOLDERS, [".json"]), self._beside(index, ("", "images"), _IMAGE_SUFFIXES))
        table = self.table_path if self._table else None
        mapping = self.mapping_path if self.class_mapping else None
        return [self.clouds[index], *(path for path in (*beside, table, mapping) if path)]

    def annotation(self, index: int) -> Annotation | None:
        """The boxes beside frame ``index``."""
        load = self._annotation_of(index)
        return None if load is None else load()

    def _annotation_of(self, index: int) -> Callable[[], Annotation] | None:
        """What gives the annotation of frame ``index``; None where it has none."""
        path, listed = self._beside(index, _BOX_FOLDERS, [".json"]), self._table.get(self.frame_ids[index])
        if path is not None:
            return partial(_read_annotation, path, self.class_mapping)
        return None if listed is None else Constant(renamed(usual(Annotation(boxes=listed)), self.class_mapping))

    def has_annotation(self, index: int) -> bool:
        """Whether boxes stand beside frame ``index``."""
        return self._annotation_of(index) is not None

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(name_time_ns(self.frame_ids[index]) for index in indices)

    @property
    def calibration_file(self) -> Path | None:
        """The calibration of the camera, one of the usual names in the root, or None."""
        return next((self.root / name for name in CALIBRATION_NAMES if (self.root / name).is_file()), None)

    @cached_property
    def _calibration(self) -> tuple[dict[str, Camera], tuple[str, ...]]:
        """The cameras, and notes on what of the file cannot be used."""
        return usable_cameras(self.calibration_file)

    @property
    def notes(self) -> tuple[str, ...]:
        """What of the calibration cannot be used."""
        return self._calibration[1]

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What was decided from the clouds: the origin of a map's coordinates."""
        return self.reading.assumptions

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self.reading.world_T_frame(self.clouds[int(index)]) for index in indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        path, stem = self.clouds[index], self.frame_ids[index]
        image = self._beside(index, ("", "images"), _IMAGE_SUFFIXES)
        images = Lazy({} if image is None else {"camera": partial(read_image, image)})
        cameras = self._calibration[0]
        load = self.reading.loader(path, name_time_ns(stem))
        return Frame(
            sequence=self.sequences[index],
            frame_id=stem,
            time_ns=name_time_ns(stem),
            clouds=Lazy({"lidar": load}),
            images=images,
            cameras=cameras,
            sensors={
                "lidar": Sensor(kind="lidar"),
                **{name: camera_sensor(cameras.get(name)) for name in dict.fromkeys([*images, *cameras])},
            },
            world_T_frame=self.reading.world_T_frame(path),
            load_annotation=self._annotation_of(index),
            metadata={"files": [str(file) for file in self.files(index)]},
        )
