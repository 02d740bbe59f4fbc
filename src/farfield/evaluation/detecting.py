"""From a detector and frames to detections, ready to be scored; each frame is built once, by whoever detects in it."""

import copy
import json
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import FrozenInstanceError, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from farfield.datasets.base import Dataset
from farfield.datasets.memory import in_memory
from farfield.detectors.info import DescribedDetector, DetectorFunction, as_detector
from farfield.errors import ConfigError, DatasetError, plain
from farfield.evaluation.leakage import (
    choice_text,
    choice_warning,
    frames_of_choice,
    leakage_warning,
    seen_in_training,
)
from farfield.evaluation.views import as_trained, motion, suitable_clouds
from farfield.files.disk_dict import DiskDict, alike
from farfield.frame import Annotation, Boxes, Cloud, Frame, Key
from farfield.frame.provenance import environment
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run, values
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.metrics.result import digest_of
from farfield.vocabulary.counts import count_of

Progress = Callable[[Iterable[int]], Iterable[int]]
_READ_ONLY = "read-only"
"""Word of numpy's errors, where an array of a frame is written into."""
_MEMORY_BYTES = 1_500_000_000  # that a process with torch and a detector's feature maps needs


def detect(
    detector: DescribedDetector | DetectorFunction,
    data: Dataset | Sequence[Frame],
    *,
    cloud: str | None = None,
    annotated_only: bool = False,
    bulk: JobOptions | None = None,
    journal: Path | None = None,
    overwrite: bool = False,
    progress: Progress = iter,
) -> Detections:
    """Detect objects in every frame.

    The frames are seen as the detector was trained to see them (:func:`as_trained`); its boxes, the annotated ones and
    ``reference`` are in those coordinates. The annotated boxes carry the number of points that the cloud has inside
    them.

    Args:
        detector: A detector, or any function from a frame to scored boxes.
        data: A data set, or frames in memory.
        cloud: Which of the frames' clouds to read; by default the first of :func:`suitable_clouds`.
        annotated_only: Leave out frames without annotation, which no score counts.
        bulk: As of :class:`DetectionPlan`.
        journal: As of :class:`DetectionPlan`; boxes and annotations too stand in a file then, of no name beside it.
        overwrite: As of :class:`DetectionPlan`.
        progress: Wraps the frame numbers, to show progress; with ``bulk`` its own does.

    Raises:
        ConfigError: If a frame has no cloud that suits the detector, or not the one asked for.
        DatasetError: If there is no frame, two have one name, or none is annotated though only such count.
    """
    # The door: a data set, and a detector that carries its description.
    described, dataset = as_detector(detector), in_memory(data)
    plan = plan_detection(
        described,
        dataset,
        cloud=cloud,
        annotated_only=annotated_only,
        bulk=bulk,
        journal=journal,
        overwrite=overwrite,
    )
    # Detect in each frame, and take from it what a score needs.
    boxes: MutableMapping[Key, Boxes] = {} if journal is None else DiskDict(journal.parent)
    annotations: MutableMapping[Key, Annotation] = alike(boxes)
    conditions: dict[Key, Mapping[str, str]] = {}
    unannotated, times_ms = 0, list[float]()
    keys, numbers = plan.task.frames.keys, range(len(plan.task.frames))
    for index, detections in zip(progress(numbers) if bulk is None else numbers, plan.detections(), strict=True):
        if detections is None:
            unannotated += 1
            continue
        key = keys[index]
        check_new_key(key, conditions)
        boxes[key], conditions[key] = detections.boxes, detections.conditions
        if detections.annotation is not None:
            annotations[key] = detections.annotation
        if detections.ms is not None:
            times_ms.append(detections.ms)
    if annotated_only and not annotations:
        name = str(dataset.root) if dataset.stored else "detect"
        raise DatasetError(f"{name}: expected annotated frames, found none with boxes.")
    # Say of what the detections are: the detector, the data, and whether it was trained on them.
    info = described.info
    leakage, common = seen_in_training(dataset, info.provenance, set(annotations))
    chosen_by = frames_of_choice(dataset, info.provenance, set(annotations))
    moved = dataset.maps != plan.task.frames.maps  # boxes are seen in other coordinates than the data's own
    return Detections(
        detector=info.name,
        detector_digest=described.digest() or "",
        data=dataset.root.name,
        fingerprint=dataset.fingerprint(),
        labels_fingerprint=digest_of(_own_annotations(dataset, annotations)) if moved else "",
        seen_in_training="; ".join(filter(None, (leakage, choice_text(chosen_by, len(annotations))))),
        notes=(
            *leakage_warning(leakage, common),
            *choice_warning(chosen_by, len(annotations)),
            *_annotation_notes(unannotated, len(numbers), annotations),
        ),
        reference=plan.reference,
        cloud=plan.task.cloud,
        classes=info.classes,
        drives=plan.task.frames.drives(),
        boxes=boxes,
        annotations=annotations,
        conditions=conditions,
        facts=label_facts(annotations),
        reach_m=info.reach_m,
        ms=tuple(times_ms),
    )


def plan_detection(
    detector: DescribedDetector | DetectorFunction,
    data: Dataset | Sequence[Frame],
    *,
    cloud: str | None = None,
    annotated_only: bool = False,
    in_own: bool = False,
    bulk: JobOptions | None = None,
    journal: Path | None = None,
    overwrite: bool = False,
) -> "DetectionPlan":
    """Prepare a detection; nothing is detected before :meth:`DetectionPlan.detections` is iterated over.

    Args:
        detector: A detector, or any function from a frame to scored boxes.
        data: A data set, or frames in memory.
        cloud: Which of the frames' clouds to read; by default the first of :func:`suitable_clouds`.
        annotated_only: Leave out frames without annotation, which no score counts.
        in_own: Give the boxes in the coordinates of ``data`` instead of those in which the detector sees them.
        bulk: As of :class:`DetectionPlan`.
        journal: As of :class:`DetectionPlan`.
        overwrite: As of :class:`DetectionPlan`.

    Raises:
        ConfigError: If a frame has no cloud that suits the detector.
        DatasetError: If there is no frame.
    """
    described, dataset = as_detector(detector), in_memory(data)
    frames = as_trained(dataset, described.info)
    if not len(frames):
        raise DatasetError("detect: expected at least one frame, found none.")
    first = frames[0]
    name = cloud or next(iter(suitable_clouds(described.info, first)), None)
    task = DetectTask(
        detector=described.with_cloud(name),
        frames=frames,
        cloud=name,
        annotated_only=annotated_only,
        own=dataset if in_own and dataset[0].reference != first.reference else None,
    )
    return DetectionPlan(task=task, reference=first.reference, bulk=bulk, journal=journal, overwrite=overwrite)


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameDetections:
    """What a detector gives for a frame, and what a score needs of the frame besides.

    Args:
        boxes: Scored boxes.
        point_count: Points of the cloud in each annotated box; None without annotation or cloud.
        annotation: What was annotated, in the coordinates in which the detector sees the frame, with ``point_count``.
        conditions: The frame's.
        ms: How long the detector took, milliseconds; None where the boxes come from a journal.
    """

    boxes: Boxes
    point_count: Int[np.ndarray, " n"] | None = None
    annotation: Annotation | None = None
    conditions: Mapping[str, str]
    ms: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Boxes and counts as JSON takes them, to the last digit; the rest stands in the frame."""
        columns = {field.name: getattr(self.boxes, field.name) for field in fields(Boxes)}
        lists = {name: column.tolist() for name, column in columns.items() if column is not None}
        return {"boxes": lists, "point_count": None if self.point_count is None else self.point_count.tolist()}

    @classmethod
    def from_json(
        cls,
        tree: Mapping[str, Any],
        *,
        annotation: Annotation | None,
        conditions: Mapping[str, str],
        ms: float | None = None,
    ) -> "FrameDetections":
        """Read what :meth:`to_json` gave, with the rest: ``annotation`` as the frame has it, without counts."""
        columns = {name: np.array(column) for name, column in tree["boxes"].items()}
        boxes = Boxes(**columns) if len(columns["yaw_rad"]) else Boxes.empty(scored="score" in columns)
        listed = tree["point_count"]
        point_count = None if listed is None else np.array(listed, dtype=np.int64)
        return cls(
            boxes=boxes,
            point_count=point_count,
            annotation=None if annotation is None else with_point_count(annotation, point_count),
            conditions=conditions,
            ms=ms,
        )


@dataclass(frozen=True, eq=False)
class _JournalledFrame:
    """What a journal does not keep of a frame: how long it took, and what the frame itself holds."""

    ms: float
    annotation: Annotation | None
    conditions: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class DetectTask:
    """Detects in one frame, whose index is the unit's parameters; gives ``FrameDetections`` (None: not annotated).

    Args:
        detector: What detects.
        frames: The frames, in the detector's coordinates and form.
        cloud: The cloud that it reads, whose points in the annotated boxes are counted.
        annotated_only: Leave out frames without annotation.
        own: The frames in whose coordinates the boxes are given; those of ``frames`` if None.
        packed: Give boxes and counts as JSON takes them; the rest then stands in the clock, which no journal keeps.
    """

    detector: DescribedDetector
    frames: Dataset
    cloud: str | None
    annotated_only: bool = False
    own: Dataset | None = None
    packed: bool = False
    memory_bytes = _MEMORY_BYTES

    def __call__(self, unit: Unit) -> UnitResult:
        """Detect in a frame, which is built here and nowhere else.

        Raises:
            ConfigError: If the detector changes the frame in place, which it must not.
        """
        frame = self.frames[unit.parameters]
        if self.annotated_only and not frame.has_annotation:
            return UnitResult()
        points = None if self.cloud is None else frame.cloud(self.cloud)  # reading a file is not the detector's time
        # What scores is taken first, and the detector gets a copy: nothing that it does to the frame reaches the score
        annotation, conditions = frame.annotation, dict(frame.conditions)
        point_count = None if annotation is None or points is None else points_in_boxes(annotation, points)
        own_T_frame = None if self.own is None else motion(frame, self.own[unit.parameters])
        shown = frame.annotated(copy.deepcopy(annotation))
        start_s = time.perf_counter()
        try:
            boxes = self.detector(shown)
        except (ValueError, FrozenInstanceError) as error:
            if isinstance(error, ValueError) and _READ_ONLY not in str(error):
                raise
            raise ConfigError(
                f"detector {self.detector.info.name or 'without a name'}, frame {'/'.join(frame.key)}: a detector must "
                f"not change what it gets: expected one that copies before it writes, got {plain(error)!r}. Write into "
                "a copy: points = frame.cloud().points_m.copy()"
            ) from error
        ms = 1e3 * (time.perf_counter() - start_s)
        boxes = copy.deepcopy(boxes) if own_T_frame is None else boxes.transform(own_T_frame)
        detections = FrameDetections(
            boxes=boxes,
            point_count=point_count,
            annotation=None if annotation is None else with_point_count(annotation, point_count),
            conditions=conditions,
            ms=ms,
        )
        if not self.packed:
            return UnitResult(value=detections)
        return UnitResult(value=detections.to_json(), clock=_JournalledFrame(ms, annotation, conditions))

    def units(self) -> list[Unit]:
        """One a frame."""
        keys = ["/".join(key) for key in self.frames.keys] if self.frames.stored else map(str, range(len(self.frames)))
        return [Unit(name, tuple(self.frames.files(index)), index) for index, name in enumerate(keys)]

    @property
    def setting(self) -> str | None:
        """All that decides the detections besides the frames' files; None where that cannot be said."""
        digest = self.detector.digest()
        if digest is None or not self.frames.files(0):
            return None
        recipes = [None if frames is None or not frames.stored else frames.recipe for frames in (self.frames, self.own)]
        return json.dumps([environment(), digest, recipes, self.cloud, self.annotated_only])


@dataclass(frozen=True, kw_only=True)
class DetectionPlan:
    """A detector and frames in which it is going to detect.

    Args:
        task: Detects in one frame.
        reference: Name of the coordinates in which the detector sees the frames.
        bulk: Who does it; None for this process with all its threads.
        journal: A file that keeps the boxes, so that the detection resumes, and memory does not grow with it; None
            keeps nothing. A plain function that detects has no identity: for it nothing is kept.
        overwrite: Detect again what the journal has.
    """

    task: DetectTask
    reference: str
    bulk: JobOptions | None = None
    journal: Path | None = None
    overwrite: bool = False

    def detections(self) -> Iterator[FrameDetections | None]:
        """The detections in each frame, in their order; None where a frame does not count.

        With a journal everything is detected before this returns, else while it is iterated over.
        """
        units, setting = self.task.units(), self.task.setting
        if self.journal is None or setting is None:
            results = map(self.task, units) if self.bulk is None else values(self.task, units, self.bulk)
            return (result.value for result in results)
        journal = JobJournal(self.journal, setting, overwrite=self.overwrite, files=False)
        outcome = run(replace(self.task, packed=True), units, self.bulk or JobOptions(), journal=journal)
        trees = enumerate(journal.values(unit.name for unit in units))
        return (
            None if tree is None else self._unpacked(index, tree, outcome.clocks.get(index)) for index, tree in trees
        )

    def _unpacked(self, index: int, tree: Mapping[str, Any], rest: _JournalledFrame | None) -> FrameDetections:
        """Detections of a journal; a frame that an earlier run detected in is built now, for its annotation."""
        if rest is not None:
            return FrameDetections.from_json(tree, annotation=rest.annotation, conditions=rest.conditions, ms=rest.ms)
        frame = self.task.frames[index]
        return FrameDetections.from_json(tree, annotation=frame.annotation, conditions=frame.conditions)


def points_in_boxes(annotation: Annotation, cloud: Cloud) -> Int[np.ndarray, " n"]:
    """How many points of a cloud lie in each annotated box: scan patterns share their boxes."""
    return count_points_in_boxes(cloud.points_m, annotation.boxes, margin_m=BOX_MARGIN_M)


def with_point_count(annotation: Annotation, point_count: Int[np.ndarray, " n"] | None) -> Annotation:
    """An annotation whose boxes carry the counts; as it is without counts."""
    if point_count is None:
        return annotation
    return annotation.replaced(annotation.boxes.replace(point_count=point_count))


def check_new_key(key: Key, before: Collection[Key]) -> None:
    """Refuse a second frame of one key: one of the two would be lost without a word."""
    if key in before:
        sequence, name = key
        raise DatasetError(
            f"frame {name!r} of sequence {sequence!r}: expected each frame once, found a second one of this name. Give "
            "frames of your own different names: Frame.of(..., frame_id=...)."
        )


def _annotation_notes(unannotated: int, frames: int, annotations: Mapping[Key, Annotation]) -> list[str]:
    """How many frames were left out, and whether there is nothing to find in the others."""
    notes = [f"{unannotated} of {count_of(frames, 'frame')} are not annotated and do not count"] if unannotated else []
    if annotations and not any(len(annotation) for annotation in annotations.values()):
        notes.append(
            f"no box is annotated in {count_of(len(annotations), 'annotated frame')}: there is nothing to score"
        )
    return notes


def _own_annotations(data: Dataset, keys: Collection[Key]) -> Iterator[tuple[Key, Annotation]]:
    """The annotations of some frames in the data's own coordinates, in the order of the frames' names."""
    indices = {key: index for index, key in enumerate(data.keys) if key in keys}
    for key in sorted(indices, key=frame_order):
        annotation = data.annotation(indices[key])
        if annotation is not None:
            yield key, annotation


def label_facts(annotations: Mapping[Key, Annotation]) -> dict[str, str]:
    """What annotations say of themselves: their version, where they have one."""
    versions = sorted({annotation.version for annotation in annotations.values()} - {""})
    return {"label_version": " and ".join(versions)} if versions else {}


def median_ms(detections: Detections) -> float:
    """Median time that a frame took from points to boxes, milliseconds; NaN without frames."""
    return float(np.median(detections.ms)) if detections.ms else float("nan")
