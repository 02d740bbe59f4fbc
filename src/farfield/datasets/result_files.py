"""A detector's boxes in the result files of other tools, one form each, and what each form cannot hold."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.convert import box_rows
from farfield.datasets.kitti.boxes import objects_from_boxes
from farfield.datasets.kitti.object import VIRTUAL_CAMERA, Kitti
from farfield.datasets.labels.json_labels import file_name as spelled_out
from farfield.datasets.nuscenes.reader import SchemaDataset
from farfield.datasets.tool_results import KIT_NAMES, write_instances_of, write_kit, write_pcdet_text
from farfield.errors import ConfigError
from farfield.files.argoverse2_boxes import write_argoverse2_boxes
from farfield.files.atomic import open_atomic
from farfield.files.boxes_csv import BoxRows, write_boxes_csv_parts
from farfield.files.coordinates import camera_words, read_coordinates, write_coordinates
from farfield.files.kitti import write_labels
from farfield.files.nuscenes import WORLD
from farfield.files.waymo_objects import write_waymo_objects
from farfield.frame import Boxes, Frame, Key
from farfield.metrics.submissions import (
    ARGOVERSE2_NAMES,
    WAYMO_TYPES,
    argoverse2_part,
    stamp_of,
    waymo_part,
)
from farfield.vocabulary.classes import KITTI_FROM_CIRRUS, NUSCENES_FROM_CIRRUS, NUSCENES_RANGES_M
from farfield.vocabulary.counts import count_of

ResultFormat = Literal["boxes-csv", "kitti", "nuscenes", "argoverse2", "waymo", "kradar", "openpcdet", "mmdetection3d"]
RESULT_FORMATS: tuple[str, ...] = get_args(ResultFormat)
_SUFFIX = {".csv": "boxes-csv", ".json": "nuscenes", ".feather": "argoverse2", ".bin": "waymo"}
FOLDERS = ("kitti", "kradar", "openpcdet", "mmdetection3d")
"""Forms that are a folder with a file a frame."""
_WANTED = {format: f"a file ending in {suffix}" for suffix, format in _SUFFIX.items()} | dict.fromkeys(
    FOLDERS, "a folder"
)
_MOST_IN_A_SAMPLE = 500
_LEAST_NS, _MOST_US = 10**17, 10**17  # of 1973 and of 5138: one stamp is not both

Found = Iterable[tuple[Key, Boxes]]
"""Scored boxes by (sequence, frame), frame after frame."""


def result_format(out: Path | None, format: str | None = None) -> str:
    """The format of a file or folder of results: the one asked for, or what the suffix says.

    Args:
        out: Where to write; None prints.
        format: One of ``RESULT_FORMATS``; None leaves it to the suffix.

    Raises:
        ConfigError: If the name does not fit the format, or says none.
    """
    if format is not None and format not in RESULT_FORMATS:
        raise ConfigError(f"format: expected one of {', '.join(RESULT_FORMATS)}, got {format!r}")
    if out is None:
        if format not in (None, "boxes-csv"):
            raise ConfigError(f"--to {format} needs --out: {_WANTED[str(format)]}")
        return "boxes-csv"
    suffix_format = _SUFFIX.get(out.suffix)
    if format is None and suffix_format is None:
        raise ConfigError(
            f"--out {out}: expected a name ending in .csv (boxes as CSV), .json (nuScenes' results), .feather "
            f"(Argoverse 2's) or .bin (Waymo's), or a folder with --to {'|'.join(FOLDERS)}"
        )
    chosen = format or str(suffix_format)
    fits = (
        suffix_format is None and not out.is_file()
        if chosen in FOLDERS
        else suffix_format == chosen and not out.is_dir()
    )
    if not fits:
        what = "a folder" if out.is_dir() else "that name"
        raise ConfigError(f"--out {out}: expected {_WANTED[chosen]} for the format {chosen}, got {what}")
    return chosen


@dataclass
class ResultWriter:
    """Writes results, once, and remembers what was assumed.

    Args:
        format: One of ``RESULT_FORMATS``.
        frames: The frames in whose coordinates the boxes stand, in the order in which they come.
        keys: Their (sequence, frame).
        kind: Of which kind of sensor the detector reads the clouds.
        classes: Classes that the detector has, in its order.
        strict: Whether the form is the tool's own to the letter, as with ``--to``: :meth:`check` then refuses what
            the data cannot give; else what stands for it is noted.
        notes: What was assumed, once written.
    """

    format: str
    frames: Sequence[Frame] | Dataset
    keys: Sequence[Key]
    kind: str = "lidar"
    classes: Sequence[str] = ()
    strict: bool = False
    notes: list[str] = field(default_factory=list)

    def check(self) -> None:
        """See whether the data give what the form names its frames by.

        Raises:
            ConfigError: If they do not; says what there is instead.
        """
        if self.format in ("argoverse2", "waymo"):
            self._check_submission()
        if not self.strict:
            return
        first = self.frames[0]
        reader = self.frames.unwrapped if isinstance(self.frames, Dataset) else None
        if self.format == "nuscenes" and not isinstance(reader, SchemaDataset):
            raise ConfigError(
                f"--to nuscenes: expected data in nuScenes' schema, whose samples have tokens by which its results are "
                f"keyed; {_named_data(self.frames)} names its frames otherwise, such as {first.frame_id!r}. --out "
                "NAME.json without --to writes the same JSON keyed by these names"
            )
        if self.format == "nuscenes" and first.world_T_frame is None:
            raise ConfigError("--to nuscenes: expected poses, since its results stand in the world; the data have none")
        if self.format == "openpcdet" and not first.cameras:
            raise ConfigError(
                f"--to openpcdet: expected a calibrated camera, since its texts stand in KITTI's camera; "
                f"{_named_data(self.frames)} has none. --to mmdetection3d or boxes-csv need none"
            )

    def losses(self) -> list[str]:
        """What of the detector's boxes the form does not hold, a sentence each: said before anything is written."""
        without_velocity = ("kitti", "argoverse2", "waymo", "kradar", "openpcdet")
        lost = ["velocities of boxes: none there"] if self.format in without_velocity else []
        names = {"argoverse2": ARGOVERSE2_NAMES, "waymo": WAYMO_TYPES, "kradar": KIT_NAMES}.get(self.format)
        if self.format == "nuscenes" and self.strict:
            names = _NUSCENES_NAMES
            lost.append(
                f"boxes of a sample beyond the {_MOST_IN_A_SAMPLE} of the highest scores: the tool refuses more"
            )
        if names is not None and (absent := [name for name in self.classes if name not in names]):
            lost.append(f"boxes of the classes {', '.join(absent)}: none there")
        merged = {name: (names or {}).get(name, name) for name in self.classes}
        shared = sorted({other for name, other in merged.items() if [*merged.values()].count(other) > 1})
        for other in shared:
            own = [name for name, written in merged.items() if written == other]
            lost.append(f"which of {', '.join(own)} a box is: all are {other}")
        if self.format == "waymo":
            lost.append("digits of scores: single precision")
        if self.format == "kradar":
            lost.append("names of frames: numbered anew (the file FRAMES beside the texts says which they are)")
            if self._annotated():
                lost.append("frames without an annotated box: left out, as the kit does")
            else:
                lost.append("annotated boxes: the data have none, so that gts and val.txt are not written")
            if not self.frames[0].conditions:
                lost.append("conditions: not known, so that all is the only folder")
        return [f"loses {loss}" for loss in lost]

    def _annotated(self) -> bool:
        return any(self.frames[number].has_annotation for number in range(len(self.keys)))

    def write(self, out: Path, frame_boxes: Found) -> None:
        """Write all boxes; a file appears whole or not at all.

        Args:
            out: A file, or a folder for the forms of :data:`FOLDERS`.
            frame_boxes: The boxes of each frame.

        Raises:
            ConfigError: As :meth:`check`.
        """
        self.check()
        out.parent.mkdir(parents=True, exist_ok=True)
        if self.format == "kitti":
            self._kitti(out, frame_boxes)
        elif self.format == "kradar":
            self.notes += write_kit(out, frame_boxes, self.frames, annotated=self._annotated())
        elif self.format in ("openpcdet", "mmdetection3d"):
            self._texts(out, frame_boxes)
        elif self.format == "nuscenes":
            self._nuscenes(out, frame_boxes)
        elif self.format in ("argoverse2", "waymo"):
            self._submission(out, frame_boxes)
        else:
            write_boxes_csv_parts(out, rows_of(frame_boxes, self.frames[0].reference))

    def _texts(self, out: Path, frame_boxes: Found) -> None:
        """A file a frame, below a folder for each of several sequences."""
        several = len({sequence for sequence, _ in self.keys}) > 1
        for number, ((sequence, frame_id), boxes) in enumerate(frame_boxes):
            frame = self.frames[number]
            folder = out / file_name(sequence) if several else out
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{file_name(frame_id)}.txt"
            if self.format == "openpcdet":
                write_pcdet_text(path, boxes, next(iter(frame.cameras.values()), VIRTUAL_CAMERA))
                write_coordinates(folder, coordinates_of_text(self.frames, frame))
            else:
                write_instances_of(path.with_suffix(".json"), boxes, self.classes, frame.reference)

    def _check_submission(self) -> None:
        """See that boxes stand in the vehicle's coordinates, and that frames are named by stamps."""
        whose, own = ("Argoverse 2", "ego") if self.format == "argoverse2" else ("Waymo", "vehicle")
        reference = self.frames[0].reference
        if reference not in ("ego", "vehicle"):
            raise ConfigError(
                f"--to {self.format}: expected boxes in the coordinates of the vehicle ({own}), as {whose}'s "
                f"submissions have them; got {reference or 'some that have no name'}. "
                "Take --reference ego where the data have it, or another format"
            )
        for key in self.keys:
            stamp = stamp_of(key)
            if not self.strict:
                continue
            if not key[0]:
                part = "log" if self.format == "argoverse2" else "context"
                raise ConfigError(f"frame {key}: expected the name of its {part} as its sequence, got none")
            if self.format == "argoverse2" and stamp < _LEAST_NS:
                raise ConfigError(f"frame {key}: expected a stamp in nanoseconds as its name, got {stamp}")
            if self.format == "waymo" and stamp >= _MOST_US:
                raise ConfigError(f"frame {key}: expected a stamp in microseconds as its name, got {stamp}")

    def _submission(self, out: Path, frame_boxes: Found) -> None:
        """One file of all frames in the vehicle's coordinates, whose frames are named by their stamps."""
        written = _WrittenClasses(frame_boxes, ARGOVERSE2_NAMES if self.format == "argoverse2" else WAYMO_TYPES)
        if self.format == "argoverse2":
            write_argoverse2_boxes(out, (argoverse2_part(key, boxes) for key, boxes in written))
        else:
            write_waymo_objects(out, (waymo_part(key, boxes) for key, boxes in written))
            self.notes.append("scores are rounded to single precision, which the format holds")
        self.notes += written.notes()

    def _kitti(self, out: Path, frame_boxes: Found) -> None:
        """``FRAME.txt`` for each frame, the empty ones too, below a folder for each of several sequences."""
        several = len({sequence for sequence, _ in self.keys}) > 1
        virtual, named = 0, set[Path]()
        for number, ((sequence, frame_id), boxes) in enumerate(frame_boxes):
            frame = self.frames[number]
            camera = None if frame.front_camera is None else frame.cameras[frame.front_camera]
            virtual += camera is None
            folder = out / file_name(sequence) if several else out
            if folder not in named:
                named.add(folder)
                write_coordinates(folder, coordinates_of_text(self.frames, frame))
            objects = objects_from_boxes(boxes, camera or VIRTUAL_CAMERA, classes=KITTI_FROM_CIRRUS)
            write_labels(folder / f"{file_name(frame_id)}.txt", objects)
        if virtual:
            self.notes.append(
                f"{count_of(virtual, 'frame has', 'frames have')} no camera: their boxes "
                "stand in KITTI's axes at the sensor, and 2D boxes are "
                "those of a virtual camera there"
            )

    def _nuscenes(self, out: Path, frame_boxes: Found) -> None:
        """One list of boxes a sample, in the world where every frame's pose is known."""
        posed = all(self.frames[number].world_T_frame is not None for number in range(len(self.keys)))
        plain = len({frame for _, frame in self.keys}) == len(self.keys)
        meta = {"use_camera": False, "use_map": False, "use_external": False}
        meta |= {"use_lidar": self.kind == "lidar", "use_radar": self.kind == "radar"}
        meta_text = json.dumps(meta | {"reference": WORLD if posed else self.frames[0].reference})
        still = False
        names = _NUSCENES_NAMES if self.strict else None
        left_out: dict[str, int] = {}
        beyond = 0
        with open_atomic(out) as handle:
            handle.write(f'{{"meta": {meta_text}, "results": {{'.encode())
            for number, ((sequence, frame_id), boxes) in enumerate(frame_boxes):
                pose = self.frames[number].world_T_frame if posed else None
                token = frame_id if plain else f"{sequence}/{frame_id}"
                if names is not None:
                    fits = np.isin(boxes.label, [*names])
                    for name in np.asarray(boxes.label)[~fits].tolist():
                        left_out[str(name)] = left_out.get(str(name), 0) + 1
                    boxes = boxes[fits]
                    beyond += max(0, len(boxes) - _MOST_IN_A_SAMPLE)
                    if len(boxes) > _MOST_IN_A_SAMPLE and boxes.score is not None:
                        boxes = boxes[np.sort(np.argsort(-boxes.score, kind="stable")[:_MOST_IN_A_SAMPLE])]
                still = still or (len(boxes) > 0 and boxes.velocity_m_s is None)
                rows = list(_samples(token, boxes if pose is None else boxes.transform(pose)))
                handle.write(f"{', ' if number else ''}{json.dumps(token)}: {json.dumps(rows)}".encode())
            handle.write(b"}}\n")
        where = "the world" if posed else f"each frame ({self.frames[0].reference}), since poses are not known"
        self.notes.append(f"boxes stand in the coordinates of {where}")
        self.notes += _left_out(left_out)
        if beyond:
            self.notes.append(f"{count_of(beyond, 'box', 'boxes')} beyond {_MOST_IN_A_SAMPLE} a sample are left out")
        if still:
            self.notes.append("velocities are not known and stand as 0: nuScenes' results must have numbers there")


class _WrittenClasses:
    """The boxes frame by frame, and under which names their classes are written.

    Args:
        frame_boxes: The boxes of each frame.
        names: The other tool's name of each class that it has.
    """

    def __init__(self, frame_boxes: Found, names: Mapping[str, str]) -> None:
        self.frame_boxes, self.names = frame_boxes, names
        self.counts: dict[str, int] = {}

    def __iter__(self) -> Iterator[tuple[Key, Boxes]]:
        for key, boxes in self.frame_boxes:
            for name, count in zip(*np.unique(boxes.label, return_counts=True), strict=True):
                self.counts[str(name)] = self.counts.get(str(name), 0) + int(count)
            yield key, boxes

    def notes(self) -> list[str]:
        """Which classes have other names there, and how many boxes are of a class that it lacks."""
        other = {name: self.names[name] for name in sorted(self.counts) if self.names.get(name, name) != name}
        lost = {name: count for name, count in sorted(self.counts.items()) if name not in self.names}
        notes = [f"classes are called {', '.join(f'{own} for {name}' for name, own in other.items())}"] if other else []
        return notes + _left_out(lost)


def _left_out(lost: Mapping[str, int]) -> list[str]:
    listed = ", ".join(f"{name} ({count})" for name, count in sorted(lost.items()))
    return [f"boxes of classes that the format does not have are left out: {listed}"] if lost else []


def file_name(name: str) -> str:
    """A sequence's or frame's name as that of a file: as it is, unless it would lead elsewhere.

    >>> file_name("a b"), file_name("../b"), file_name("..")
    ('a b', '_b', '_')
    """
    return name if name and Path(name).name == name and name.isprintable() else spelled_out(name)


def _named_data(frames: Sequence[Frame] | Dataset) -> str:
    return str(frames.root) if isinstance(frames, Dataset) else "what is there"


_NUSCENES_NAMES = {**{name: name for name in NUSCENES_RANGES_M}, **NUSCENES_FROM_CIRRUS}
"""nuScenes' detection class of each class: its own ten, and of those that are one class of ours."""


def rows_of(frame_boxes: Found, reference: str = "") -> Iterator[BoxRows]:
    """Rows of a CSV file, one frame at a time; ``reference`` names the coordinates of the boxes."""
    for key, boxes in frame_boxes:
        yield box_rows([(key, boxes)], reference=reference)


def _named(boxes: Boxes, names: Mapping[str, str]) -> dict[str, str]:
    """The other tool's name of each class; one that has none there keeps its own."""
    return {name: names.get(name, name) for name in map(str, np.unique(boxes.label))}


def _samples(token: str, boxes: Boxes) -> Iterator[dict[str, Any]]:
    names, half = _named(boxes, NUSCENES_FROM_CIRRUS), boxes.yaw_rad / 2
    velocity = np.zeros((len(boxes), 2)) if boxes.velocity_m_s is None else np.nan_to_num(boxes.velocity_m_s[:, :2])
    score = np.ones(len(boxes)) if boxes.score is None else boxes.score
    for row in range(len(boxes)):
        yield {
            "sample_token": token,
            "translation": boxes.centre_m[row].tolist(),
            "size": boxes.size_m[row, [1, 0, 2]].tolist(),
            "rotation": [float(np.cos(half[row])), 0.0, 0.0, float(np.sin(half[row]))],
            "velocity": velocity[row].tolist(),
            "detection_name": names[str(boxes.label[row])],
            "detection_score": float(score[row]),
            "attribute_name": "",
        }


def coordinates_of_text(frames: Sequence[Frame] | Dataset, frame: Frame) -> str:
    """What boxes in KITTI's text stand in: as the labels of a converted data set name it, else the frame's camera."""
    reader = frames.unwrapped if isinstance(frames, Dataset) else None
    beside = read_coordinates(reader.folder / "label_2") if isinstance(reader, Kitti) else ""
    return beside or camera_words(frame.front_camera or "", frame.reference)
