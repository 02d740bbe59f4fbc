"""A data set that is being annotated, without a browser: opened, with what fits, checks, proposals and saves need.

Edits go through its :class:`~farfield.annotation.store.Store`, each as a plan of :mod:`farfield.annotation.edits`::

    with Annotator(open_dataset("drives"), extent="full") as annotator:
        anna, key = Author("anna"), annotator.store.keys[0]
        value = {"label": "car", "box": [12.0, 3.0, -0.9, 4.5, 1.9, 1.6, 0.1]}
        annotator.store.edit(anna, "e1", "box.add", partial(add_box, key=key, name="n1", value=value))
        undo(annotator.store, anna, "u1")
        issues = annotator.check(0)
        annotator.save(anna, "s1")
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.annotation.checking import CheckSettings, DetectorBox, LabelIssue, SizeRange
from farfield.annotation.edits import LARGEST_M, add_box
from farfield.annotation.findings import findings, settings_of, size_ranges
from farfield.annotation.fitting import (
    BoxFit,
    Prior,
    fit_click,
    fit_drag,
    fit_radar_peak,
    fit_rectangle,
    prior_of,
    refit,
)
from farfield.annotation.motion import RefitBox, TrackFrame, from_world, to_world
from farfield.annotation.saving import SaveSummary, save, save_target, unwritten_in
from farfield.annotation.schema import (
    AttributeSettings,
    ClassSettings,
    Extent,
    Schema,
    Size,
    annotated_classes,
    cirrus_class,
    fastest,
    shown_classes,
)
from farfield.annotation.store import Author, EditResult, Store
from farfield.annotation.surroundings import SortedPoints, cloud_name
from farfield.datasets.base import Dataset
from farfield.datasets.edits import CellEdit, journal_folder, track_cell
from farfield.datasets.edits.journal import user_folder
from farfield.datasets.labels import BoxLabel, LabelFormat, Numbers
from farfield.datasets.labels.formats import label_files_in, label_format
from farfield.errors import ConfigError, FarfieldError
from farfield.files.atomic import read_bytes, write_bytes
from farfield.frame import Boxes, Frame, Key
from farfield.geometry.iou import pairwise_iou
from farfield.vocabulary.classes import CIRRUS_CLASSES, SMALL_KINDS, VEHICLE_KINDS
from farfield.vocabulary.counts import count_of

START = "labels.csv"
_OPENING_FRAMES = 50
"""So many frames are read to find the classes and their sizes, and the first ones for the extent, of a data set."""
_FEWEST_FOR_MEDIAN = 5
"""Of fewer boxes of a class the median says less than the published size."""
_SIZE_FRAMES = 500
"""Frames whose boxes tell the sizes of the data set's classes."""
_NEIGHBOURS, _NEIGHBOUR_M, _LANE_M = 5, 30.0, 1.75
"""So many vehicles within so far tell how others drive; one so little beside stands in the same lane."""
_SAME_IOU = 0.1
"""A detection that overlaps a box so much is not proposed beside it."""


@dataclass(frozen=True, kw_only=True)
class Gesture:
    """What a person did to get a box.

    Args:
        kind: ``click`` on an object, ``drag`` along its heading, ``rectangle`` around it, ``refit`` of a box that is
            there, or a ``peak`` of the radar.
        at: x and y, metres: of a click or peak; start and end of a drag; the four corners of a rectangle.
        class_name: The class chosen.
        type_name: The kind of vehicle within it; empty for none.
        track: The track that the box belongs to, or None.
        box: Of a refit: the box as it is.
        keep_size: Of a refit: whether the size stays.

    Raises:
        ConfigError: If numbers are missing.
    """

    kind: Literal["click", "drag", "rectangle", "refit", "peak"]
    at: tuple[float, ...] = ()
    class_name: str
    type_name: str = ""
    track: str | None = None
    box: Numbers | None = None
    keep_size: bool = False

    def __post_init__(self) -> None:
        count = {"click": 2, "drag": 4, "rectangle": 8, "refit": 0, "peak": 2}[self.kind]
        if len(self.at) < count or (self.kind == "refit" and self.box is None):
            raise ConfigError(f"fit: a {self.kind} needs {count or 'a box and no'} numbers")


class Annotator:
    """One data set's annotation.

    Args:
        data: The data set, without maps.
        frame: Gives a frame by its number, such as a cache (default: the data set's own).
        classes: ``name:length,width,height`` of the classes to offer (default: the data set's own).
        extent: What the boxes hold, whole bodies or visible parts; None where it is still to be declared.
        edits: Folder of the journal (default: beside the labels).
        out: Folder into which labels are saved; see :func:`~farfield.annotation.saving.save_place` unless given.
        to: Format of the saved labels (default: the data set's own).
        write: Whether saves go into the data set's own label files.

    Raises:
        FarfieldError: If another process annotates it, or the journal or its classes are damaged.
    """

    def __init__(
        self,
        data: Dataset,
        *,
        frame: Callable[[int], Frame] | None = None,
        classes: Sequence[str] = (),
        extent: Extent | None = None,
        edits: Path | None = None,
        out: Path | None = None,
        to: str = "",
        write: bool = False,
    ) -> None:
        self.frame = frame or data.__getitem__
        self.out, self.to, self.write = out, to, write
        self.store = open_store(data, classes=classes, extent=extent, edits=edits, write=write)
        self.points = SortedPoints(self.frame)

    @property
    def save_folder(self) -> Path | None:
        """Where saves go: None for the label files in their places."""
        return save_target(self.store, self.out, write=self.write)

    def save(self, author: Author, id: str, *, folder: str | None = None, format: str = "") -> SaveSummary:
        """Write the label files as the annotation stands.

        Args:
            author: Who saves.
            id: The client's name of the save.
            folder: A name beside the usual folder; None for the usual one.
            format: Another format than the labels' own; empty for their own.

        Raises:
            UnwrittenError: If boxes cannot be written in the format, once the files of all others are written.
            FarfieldError: If the folder holds something else, or cannot be written to.
        """
        return save(self.store, author, id, target=self.save_folder, folder=folder, format=format or self.to)

    def unwritten(self, *, folder: str | None = None, format: str = "") -> int:
        """How many edits of boxes the label files of a save lack; arguments as of :meth:`save`."""
        return unwritten_in(self.store, target=self.save_folder, folder=folder, format=format or self.to)

    # Checks

    def check(self, index: int, detections: Boxes | None = None) -> list[LabelIssue]:
        """What a person should look at in a frame, errors first.

        Args:
            index: The frame's number.
            detections: What a detector found in it.
        """
        return findings(
            self.store,
            self.store.keys[index],
            self.limits,
            around=self.points.around(index, "lidar"),
            detections=[] if detections is None else self._detector_boxes(detections),
        )

    def check_once(
        self, index: int, before: Sequence[LabelIssue] = (), detections: Boxes | None = None, *, points: bool
    ) -> list[LabelIssue]:
        """Findings of a frame that is one of many: its cloud is read for this once, or not at all.

        Args:
            index: The frame's number.
            before: What was found in it before: without ``points``, what that found against them still stands.
            detections: What a detector found in it.
            points: Whether the frame's points are looked at.

        Raises:
            FarfieldError: If the frame or its labels cannot be read.
        """
        return findings(
            self.store,
            self.store.keys[index],
            self.limits,
            around=SortedPoints(self.store.data.__getitem__).around(index, "lidar") if points else None,
            detections=[] if detections is None else self._detector_boxes(detections),
            before=before,
        )

    @property
    def limits(self) -> CheckSettings:
        """Limits of the checks: what the schema says, with the sizes of the data set's own boxes."""
        return settings_of(self.store, sizes=self._sizes)

    @cached_property
    def _sizes(self) -> dict[str, SizeRange]:
        """Sizes by class as the label files have them, of frames from beginning to end."""
        keys = self.store.keys
        sample = keys[:: max(1, -(-len(keys) // _SIZE_FRAMES))]
        labels = itertools.chain.from_iterable(self._file_labels(key) for key in sample)
        ranges = size_ranges(labels, settings_of(self.store).sizes)
        return {name: size for name, size in ranges.items() if size.low is not None}

    def _file_labels(self, key: Key) -> Sequence[BoxLabel]:
        try:
            with self.store.lock:
                return self.store.files.labels(key)
        except FarfieldError:
            return ()  # reported when the frame is opened

    def _detector_boxes(self, boxes: Boxes) -> list[DetectorBox]:
        scores = [1.0] * len(boxes) if boxes.score is None else boxes.score.tolist()
        return [
            DetectorBox(self._spelling(str(boxes.label[row])), box_numbers(boxes, row), score)
            for row, score in enumerate(scores)
        ]

    def _spelling(self, label: str) -> str:
        """A detector's class as the label files spell it; its own word where they have none."""
        classes = self.store.schema.classes
        return next((name for name in classes if cirrus_class(name) == cirrus_class(label)), label)

    # Proposals

    def propose(self, author: Author, id: str, index: int, boxes: Boxes, group: str) -> EditResult | None:
        """Add a detector's boxes as proposals, but those that overlap a box that is there; None if none is left.

        Args:
            author: Who asked for them.
            id: The client's name of the edit.
            index: The frame's number.
            boxes: n boxes, with scores or without.
            group: Joins the proposals of several frames, which are taken back together.
        """
        key = self.store.keys[index]
        # A size that is not positive becomes 1 mm.
        table = np.array([row.label.box for row in self.store.rows(key)], dtype=np.float64).reshape(-1, 7)
        present = Boxes(centre_m=table[:, :3], size_m=np.maximum(table[:, 3:6], 1e-3), yaw_rad=table[:, 6])
        if len(present) and len(boxes):
            boxes = boxes[pairwise_iou(boxes, present, kind="bev").max(axis=1) < _SAME_IOU]
        proposals = [self._proposal(boxes, row) for row in range(len(boxes))]
        proposals = [value for value in proposals if value["label"] in self.store.schema.classes]
        if not proposals:
            return None
        plan = partial(_add_boxes, key=key, values=proposals, prefix=id)
        return self.store.edit(author, id, "box.add", plan, group=group)

    def _proposal(self, boxes: Boxes, row: int) -> dict[str, object]:
        box = list(box_numbers(boxes, row))
        value: dict[str, object] = {"label": self._spelling(str(boxes.label[row])), "box": box, "proposal": list(box)}
        value |= {"state": "proposed", "source": "detector"}
        return value if boxes.score is None else value | {"score": float(boxes.score[row])}

    # Fits

    def fit(self, index: int, gesture: Gesture) -> BoxFit:
        """Find the box that a gesture means, on the frame's original points.

        Raises:
            ValueError: If the gesture is not possible, such as a rectangle of which two corners are one.
        """
        frame = self.frame(index)
        points_m, at, prior = _points_m(frame), gesture.at, self.prior(index, gesture)
        match gesture.kind:
            case "drag":
                return fit_drag(points_m, at[:2], at[2:4], prior)
            case "rectangle":
                return fit_rectangle(points_m, np.array(at, dtype=np.float64).reshape(4, 2), prior)
            case "refit":
                assert gesture.box is not None  # checked when it was made
                return refit(points_m, gesture.box, prior, keep_size=gesture.keep_size)
            case "peak":
                return fit_radar_peak(points_m, at[:2], prior)
            case _:
                return fit_click(points_m, at[:2], prior)

    def prior(self, index: int, gesture: Gesture) -> Prior:
        """What class, type, track and extent tell of an object before its points are looked at."""
        name = gesture.type_name or gesture.class_name
        schema = self.store.schema.classes.get(gesture.class_name)
        size = None if schema is None else schema.types.get(gesture.type_name, schema.size_m)
        yaw, locked = None, False
        if gesture.track is not None:
            yaw, track_size, locked = self._track_prior(index, gesture.track)
            size = track_size or size
        kind = name if name in VEHICLE_KINDS or name in SMALL_KINDS else cirrus_class(gesture.class_name)
        prior = prior_of(kind, size_m=size, extent="visible part" if self.store.extent == "visible" else "whole body")
        lane_rad, roads_rad = self._lanes(index, gesture) if prior.anchored else (None, ())
        ego_m, ego_z_m = sensor_place(self.frame(index), "radar" if gesture.kind == "peak" else "lidar")
        return Prior(
            size_m=prior.size_m,
            anchored=prior.anchored,
            extent=prior.extent,
            yaw_rad=yaw,
            lane_rad=lane_rad,
            roads_rad=roads_rad,
            fixed_size=locked,
            ego_m=ego_m,
            ego_z_m=ego_z_m,
        )

    def _lanes(self, index: int, gesture: Gesture) -> tuple[float, tuple[float, ...]]:
        """Heading of the vehicle next in the same lane, and the headings of the nearest ones, the sensor's own first.

        Most vehicles drive along the sensor's own way: that stands where no neighbour is annotated.
        """
        at = gesture.at[:2] if gesture.box is None else gesture.box[:2]
        near: list[tuple[float, float, float]] = []
        for row in self.store.rows(self.store.keys[index]):
            label = row.label
            if label.state == "rejected" or cirrus_class(label.label) in SMALL_KINDS or label.box == gesture.box:
                continue
            x, y, yaw = at[0] - label.box[0], at[1] - label.box[1], label.box[6]
            near.append((math.hypot(x, y), abs(y * math.cos(yaw) - x * math.sin(yaw)), yaw))
        near = sorted(neighbour for neighbour in near if neighbour[0] <= _NEIGHBOUR_M)
        lane_rad = next((yaw for _, beside_m, yaw in near if beside_m <= _LANE_M), 0.0)
        return lane_rad, (0.0, *(yaw for _, _, yaw in near[:_NEIGHBOURS]))

    def _track_prior(self, index: int, track: str) -> tuple[float | None, Size | None, bool]:
        """Yaw of a track in a frame, from its nearest box; its size; whether that is locked."""
        store, key = self.store, self.store.keys[index]
        drive, row = store.drives.locate(key)
        rows = [(member, store.row(member.key, member.name)) for member in store.tracks.boxes(drive, track)]
        others = [
            (abs(member.row - row), member.key, box) for member, box in rows if box is not None and member.key != key
        ]
        value = store.value(track_cell(drive, track)) or {}
        size = tuple(value["size"]) if value.get("size") else None
        if not others:
            return None, size, bool(value.get("locked"))
        _, nearest, box = min(others, key=lambda other: other[0])
        source, target = self._track_frame(nearest), self._track_frame(key)
        posed = source.world_T_frame is not None and target.world_T_frame is not None
        yaw = from_world(to_world(box.label.box, source), target)[6] if posed else box.label.box[6]
        median = np.median([other.label.box[3:6] for _, _, other in others], axis=0)
        return float(yaw), size or tuple(map(float, median)), bool(value.get("locked"))

    def _track_frame(self, key: Key) -> TrackFrame:
        return TrackFrame(key, self.store.drives.time_s(key), self.store.drives.pose(key))

    def refit_near(self, key: Key, expected: Sequence[float], reach_m: float) -> RefitBox:
        """Fit an object again where its motion takes it; for :func:`~farfield.annotation.edits.propagate_track`."""
        points_m = _points_m(self.frame(self.store.index_of[key]))
        prior = Prior(size_m=tuple(expected[3:6]), yaw_rad=float(expected[6]), fixed_size=True)  # type: ignore[arg-type]
        fit = refit(points_m, expected, prior, keep_size=True)
        distance_m = math.hypot(fit.box[0] - expected[0], fit.box[1] - expected[1])
        return RefitBox(fit.box if distance_m <= reach_m or fit.points else None, fit.points)

    def close(self) -> None:
        """Let the journal go."""
        self.store.close()

    def __enter__(self) -> "Annotator":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def open_store(
    data: Dataset,
    *,
    classes: Sequence[str] = (),
    extent: Extent | None = None,
    edits: Path | None = None,
    write: bool = False,
) -> Store:
    """Open the annotation of a data set; arguments as of :class:`Annotator`.

    Label files that Farfield can edit are edited; of other data sets what is annotated is copied once into a CSV beside
    the journal, which then holds the labels.

    Raises:
        FarfieldError: If another process annotates it, or the journal or its classes are damaged.
    """
    # The journal's folder: as given, among the user's data for frames that ship, else beside the labels.
    if edits is not None or data.name in ("samples", "open_sweeps"):
        folder = edits or user_folder(data.root)
        folder.mkdir(parents=True, exist_ok=True)
    else:
        folder = journal_folder(data.root)
    # The label files, or a CSV in their place.
    labels = label_format(data)
    if labels is None:
        if write:
            raise ConfigError(
                f"--write: the label files of this {data.name} data set cannot be edited in their places. Leave it "
                f"out: edits are kept in {folder.name}, and saved as boxes-csv, or in another format with --to."
            )
        labels = _csv_copy(data, folder)
    # What may be annotated, where classes.yaml beside the journal says nothing else.
    schema = Schema(
        extent=extent or known_extent(data),
        classes=offered_classes(data.name, classes, label_classes(labels, data)),
        attributes={name: AttributeSettings(values=tuple(values)) for name, values in labels.attributes.items()},
    )
    return Store(data, labels, folder, schema)


def known_extent(data: Dataset) -> Extent | None:
    """What the boxes of a data set hold, if the first annotated frames tell; None where none is annotated."""
    for index in range(min(len(data), _OPENING_FRAMES)):
        if data.has_annotation(index):
            annotation = data.annotation(index)
            if annotation is not None and len(annotation):
                return annotation.extent
    return None


class LabelSize(NamedTuple):
    """The size of a class in a data set's labels.

    Args:
        size_m: Median length, width and height.
        boxes: Of how many boxes.
    """

    size_m: Size
    boxes: int


def label_classes(labels: LabelFormat, data: Dataset) -> dict[str, LabelSize]:
    """The classes that boxes of some frames bear, from the first to the last, as their files spell them, with sizes."""
    files: dict[Path, list[Key]] = {}
    for key in data.keys[:: max(1, -(-len(data.keys) // _OPENING_FRAMES))]:
        files.setdefault(labels.path(key), []).append(key)
    sizes: dict[str, list[tuple[float, ...]]] = {}
    for path, keys in files.items():
        try:
            frames = labels.parse(bytes(read_bytes(path)), path, keys) if path.is_file() else {}
        except FarfieldError:
            continue  # reported when a frame of the file is opened
        for label in itertools.chain.from_iterable(frames.values()):
            if all(0 < length <= LARGEST_M for length in label.box[3:6]):
                sizes.setdefault(label.label, []).append(label.box[3:6])
    medians = {name: (np.median(rows, axis=0).tolist(), len(rows)) for name, rows in sizes.items()}
    return {
        name: LabelSize((round(length, 3), round(width, 3), round(height, 3)), boxes)
        for name, ((length, width, height), boxes) in medians.items()
    }


def offered_classes(
    format_name: str, classes: Sequence[str], label_sizes: Mapping[str, LabelSize]
) -> dict[str, ClassSettings]:
    """The classes to offer: those given, else the data set's; in Cirrus's words where its boxes bear these.

    Their usual sizes are the medians of the data set's own boxes, where it has five or more of a class; else those that
    are published of its format, else Farfield's. What boxes bear beside is offered too, with its own size: else such a
    box could be moved and no second one drawn.

    Args:
        format_name: Format of the data set.
        classes: As of :func:`~farfield.annotation.schema.shown_classes`.
        label_sizes: Of :func:`label_classes`.
    """
    presets = annotated_classes(format_name, classes)
    if label_sizes and set(label_sizes) <= set(CIRRUS_CLASSES):
        presets = shown_classes(format_name, classes)
    offered = {
        preset.name: ClassSettings(
            size_m=preset.size_m, types=dict(preset.types), fastest_m_s=fastest(preset.name), source=preset.source
        )
        for preset in presets
    }
    for name, (size_m, boxes) in label_sizes.items():
        source = f"median of {count_of(boxes, 'box')} of the data set"
        if name and name not in offered:
            offered[name] = ClassSettings(size_m=size_m, fastest_m_s=fastest(name), source=source)
        elif name and boxes >= _FEWEST_FOR_MEDIAN and not classes:
            offered[name] = offered[name].model_copy(update={"size_m": size_m, "source": source})
    return offered


def _csv_copy(data: Dataset, folder: Path) -> LabelFormat:
    """Labels in a CSV of their own, begun with what the data set has."""
    path = folder / START
    labels = label_files_in(path, "boxes-csv", reference=data[0].reference)
    if not path.is_file():
        frames = {data.keys[index]: _labels(data, index) for index in range(len(data)) if data.has_annotation(index)}
        if any(frames.values()):
            write_bytes(path, labels.render(None, path, frames))
    return labels


def _labels(data: Dataset, index: int) -> tuple[BoxLabel, ...]:
    annotation = data.annotation(index)
    if annotation is None:
        return ()
    boxes = annotation.boxes
    tracks = [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()
    return tuple(
        BoxLabel(
            id=f"n{row}",
            label=str(boxes.label[row]),
            box=box_numbers(boxes, row),
            track=str(track) if track >= 0 else "",
        )
        for row, track in enumerate(tracks)
    )


def box_numbers(boxes: Boxes, row: int) -> Numbers:
    """Centre, size and yaw of one box: x, y, z, length, width, height, yaw."""
    x, y, z, length, width, height, yaw = map(float, (*boxes.centre_m[row], *boxes.size_m[row], boxes.yaw_rad[row]))
    return x, y, z, length, width, height, yaw


def _points_m(frame: Frame) -> Float[np.ndarray, "n 3"]:
    name = cloud_name(frame, "lidar") or cloud_name(frame, "radar")
    return np.zeros((0, 3), dtype=np.float32) if name is None else frame.cloud(name).points_m


def sensor_place(frame: Frame, kind: str) -> tuple[tuple[float, float], float | None]:
    """Where the sensor of a kind stands: x and y, and z where that is known."""
    for sensor in frame.sensors.values():
        if sensor.kind == kind and sensor.frame_T_sensor is not None:
            x, y, z = sensor.frame_T_sensor[:3, 3].tolist()
            return (x, y), z
    return (0.0, 0.0), None


def _add_boxes(store: Store, key: Key, values: Sequence[dict[str, object]], prefix: str) -> Sequence[CellEdit]:
    edits = (add_box(store, key, f"{prefix}.{number}"[-64:], value) for number, value in enumerate(values))
    return list(itertools.chain.from_iterable(edits))
