"""From a detector and frames to detections, ready to be scored; each frame is built once, by whoever detects in it."""

import json
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation.leakage import leakage_warning, seen_in_training
from farfield.evaluation.views import Frames, as_trained, motion, suitable_clouds
from farfield.files.spool import DiskDict, alike
from farfield.frame import Annotation, Boxes, Cloud, Frame, Key
from farfield.frame.provenance import environment
from farfield.geometry.points import BOX_MARGIN_M, count_points_in_boxes
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run, values
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.metrics.subject import digest_of

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector


# Detecting in one frame as a unit of work, and what it gives.

AnyDetector = Callable[[Frame | Cloud], Boxes]
_BYTES = 1_500_000_000  # that a process with torch and a detector's feature maps takes


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """What was found in a frame.

    Args:
        boxes: Scored boxes.
        point_count: Points of the cloud in each annotated box; None without annotation or cloud.
    """

    boxes: Boxes
    point_count: Int[np.ndarray, " n"] | None = None

    def to_json(self) -> dict[str, Any]:
        """The same as JSON takes it, to the last digit."""
        boxes = {each.name: getattr(self.boxes, each.name) for each in fields(Boxes)}
        lists = {name: values.tolist() for name, values in boxes.items() if values is not None}
        return {"boxes": lists, "point_count": None if self.point_count is None else self.point_count.tolist()}

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> "FrameDetections":
        """Read what :meth:`to_json` gave."""
        rows = {name: np.array(values) for name, values in given["boxes"].items()}
        if not len(rows["yaw_rad"]):
            return cls(Boxes.empty(scored="score" in rows), _counts(given))
        return cls(Boxes(**rows), _counts(given))


def _counts(given: Mapping[str, Any]) -> Int[np.ndarray, " n"] | None:
    count = given["point_count"]
    return None if count is None else np.array(count, dtype=np.int64)


@dataclass(frozen=True, kw_only=True)
class DetectTask:
    """Detects in one frame, whose index is the unit's parameters; gives ``FrameDetections`` (None: not annotated).

    Args:
        detector: What detects.
        seen: The frames, as the detector sees them.
        cloud: The cloud that it reads, whose points in the annotated boxes are counted.
        annotated_only: Leave out frames without annotation.
        own: The frames in whose coordinates the boxes are given; those of ``seen`` if None.
        packed: Give the value as JSON takes it.
    """

    detector: "Detector | AnyDetector"
    seen: Frames
    cloud: str | None
    annotated_only: bool = False
    own: Frames | None = None
    packed: bool = False
    memory_bytes = _BYTES

    def __call__(self, unit: Unit) -> UnitResult:
        """Detect in a frame; the clock says how many milliseconds it took from points to boxes."""
        frame = self.seen[unit.parameters]
        if self.annotated_only and not frame.has_annotation:
            return UnitResult()
        points = None if self.cloud is None else frame.cloud(self.cloud)  # reading a file is not the detector's time
        began = time.perf_counter()
        boxes = self.detector(frame)
        ms = 1e3 * (time.perf_counter() - began)
        if self.own is not None:
            boxes = boxes.transform(motion(frame, self.own[unit.parameters]))
        annotated = None if points is None else frame.annotation
        found = FrameDetections(boxes, None if annotated is None or points is None else points_in(annotated, points))
        return UnitResult(value=found.to_json() if self.packed else found, clock=ms)

    def units(self) -> list[Unit]:
        """One a frame."""
        files = getattr(self.seen, "files", None)
        if isinstance(self.seen, Dataset):
            return [Unit("/".join(key), tuple(self.seen.files(n)), n) for n, key in enumerate(self.seen.keys)]
        frames = range(len(self.seen))
        return [Unit(str(n), () if files is None else tuple(files(n)), n) for n in frames]

    @property
    def setting(self) -> str | None:
        """All that decides what is found besides the frames' files; None where that cannot be said."""
        digest = getattr(self.detector, "digest", None)
        if digest is None or not hasattr(self.seen, "files"):
            return None
        views = [getattr(frames, "recipe", None) for frames in (self.seen, self.own)]
        return json.dumps([environment(), digest(), views, self.cloud, self.annotated_only])


def points_in(annotation: Annotation, cloud: Cloud) -> Int[np.ndarray, " n"]:
    """How many points of a cloud lie in each annotated box: scan patterns share their boxes."""
    return count_points_in_boxes(cloud.points_m, annotation.boxes, margin_m=BOX_MARGIN_M)


Progress = Callable[[Iterable[int]], Iterable[int]]


@dataclass(frozen=True, kw_only=True)
class DetectionPlan:
    """A detector and frames that it is going to see.

    Args:
        work: Detects in one frame.
        bulk: Who does it; None for this process with all its threads.
        journal: A file that keeps what was found, so that the search resumes, and memory does not grow with it; None
            keeps nothing. A plain function that detects has no identity: for it nothing is kept.
        overwrite: Search again what the journal has.
    """

    work: DetectTask
    bulk: JobOptions | None = None
    journal: Path | None = None
    overwrite: bool = False

    def found(self, clocks: dict[int, float]) -> Iterator[FrameDetections | None]:
        """What was found in each frame, in their order; None where a frame does not count.

        With a journal everything is searched before this returns, else while it is iterated over.

        Args:
            clocks: Is filled with the milliseconds that the frames took that were searched now.
        """
        units, setting = self.work.units(), self.work.setting
        if self.journal is None or setting is None:
            results = map(self.work, units) if self.bulk is None else values(self.work, units, self.bulk)
            return _timed(results, clocks)
        journal = JobJournal(self.journal, setting, overwrite=self.overwrite, files=False)
        outcome = run(replace(self.work, packed=True), units, self.bulk or JobOptions(), journal=journal)
        clocks.update({place: ms for place, ms in outcome.clocks.items() if ms is not None})
        kept = journal.values(unit.name for unit in units)
        return (None if value is None else FrameDetections.from_json(value) for value in kept)


def _timed(results: Iterable[UnitResult], clocks: dict[int, float]) -> Iterator[FrameDetections | None]:
    for place, done in enumerate(results):
        if done.clock is not None:
            clocks[place] = done.clock
        yield done.value


def plan_detection(
    detector: "Detector | AnyDetector",
    data: Frames,
    *,
    cloud: str | None = None,
    annotated_only: bool = False,
    in_own: bool = False,
    bulk: JobOptions | None = None,
    journal: Path | None = None,
    overwrite: bool = False,
) -> DetectionPlan:
    """Prepare a search; nothing is detected before :meth:`DetectionPlan.found` is iterated over.

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
    seen = as_trained(data, detector)
    if not len(seen):
        raise DatasetError("detect: expected at least one frame, found none.")
    first = seen[0]
    name = cloud or next(iter(suitable_clouds(detector, first)), None)
    work = DetectTask(
        detector=detector.with_cloud(name) if hasattr(detector, "with_cloud") else detector,
        seen=seen,
        cloud=name,
        annotated_only=annotated_only,
        own=data if in_own and data[0].reference != first.reference else None,
    )
    return DetectionPlan(work=work, bulk=bulk, journal=journal, overwrite=overwrite)


def detect(
    detector: "Detector | AnyDetector",
    data: Frames,
    *,
    cloud: str | None = None,
    annotated_only: bool = False,
    bulk: JobOptions | None = None,
    journal: Path | None = None,
    overwrite: bool = False,
    progress: Progress = iter,
) -> Detections:
    """Detect objects in every frame.

    The frames are seen as the detector learnt to see them (:func:`as_trained`); its boxes, the annotated ones and
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
    prepared = plan_detection(
        detector,
        data,
        cloud=cloud,
        annotated_only=annotated_only,
        bulk=bulk,
        journal=journal,
        overwrite=overwrite,
    )
    seen, clocks = prepared.work.seen, dict[int, float]()
    left_out = 0
    boxes: MutableMapping[Key, Boxes] = {} if journal is None else DiskDict(journal.parent)
    annotations: MutableMapping[Key, Annotation] = alike(boxes)
    conditions: dict[Key, Mapping[str, str]] = {}
    numbers = range(len(seen))
    for index, found in zip(progress(numbers) if bulk is None else numbers, prepared.found(clocks), strict=True):
        if found is None:
            left_out += 1
            continue
        frame = _once(seen[index], conditions)
        boxes[frame.key], conditions[frame.key] = found.boxes, frame.conditions
        if frame.annotation is not None:
            annotations[frame.key] = _with_counts(frame.annotation, found.point_count)
    if annotated_only and not annotations:
        raise DatasetError(f"{_where(data)}: expected annotated frames, found none with boxes.")
    words, common = seen_in_training(data, getattr(detector, "provenance", None) or {}, set(annotations))
    return Detections(
        **_named(detector, data, annotations),
        seen_in_training=words,
        notes=(*leakage_warning(words, common), *_unannotated(left_out, len(seen), annotations)),
        reference=seen[0].reference,
        cloud=prepared.work.cloud,
        classes=tuple(getattr(detector, "class_names", ())),
        drives=seen.drives() if isinstance(seen, Dataset) else (),
        boxes=boxes,
        annotations=annotations,
        conditions=conditions,
        facts=_facts(annotations),
        reach_m=getattr(getattr(detector, "config", None), "reach_m", None),
        ms=tuple(clocks[place] for place in sorted(clocks)),
    )


def _unannotated(left_out: int, frames: int, annotations: Mapping[Key, Annotation]) -> list[str]:
    """What was not looked at, and that there is nothing to find."""
    notes = [f"{left_out} of {frames} frames are not annotated and do not count"] if left_out else []
    if annotations and not any(len(annotation) for annotation in annotations.values()):
        notes.append(f"no box is annotated in {len(annotations)} annotated frames: there is nothing to score")
    return notes


def _once(frame: Frame, before: Collection[Key]) -> Frame:
    """The frame, unless one of its key came before: of two, one would be lost without a word."""
    if frame.key in before:
        sequence, name = frame.key
        raise DatasetError(
            f"frame {name!r} of sequence {sequence!r}: expected each frame once, found a second one of this name. Give "
            "frames of your own different names: Frame.of(..., frame_id=...)."
        )
    return frame


def _named(detector: Any, data: Frames, annotations: Mapping[Key, Annotation]) -> dict[str, Any]:
    """Who detects in what: names, and what tells equal names apart."""
    known: dict[str, Any] = {"detector": str(getattr(detector, "name", "") or getattr(detector, "__name__", ""))}
    if hasattr(detector, "digest"):
        known["detector_digest"] = detector.digest()
    if isinstance(data, Dataset):
        known |= _data_names(data)
        if data.maps != as_trained(data, detector).maps:  # boxes are seen in other coordinates than the data's own
            known["labels_fingerprint"] = digest_of(_as_given(data, annotations))
    return known


def _data_names(data: Frames) -> dict[str, Any]:
    return {"data": data.root.name, "fingerprint": data.fingerprint()} if isinstance(data, Dataset) else {}


def _as_given(data: Dataset, marked: Mapping[Key, Any]) -> Iterator[tuple[Key, Annotation]]:
    """The annotations of some frames in the data's own coordinates, in the order of the frames' names."""
    places = {key: index for index, key in enumerate(data.keys) if key in marked}
    for key in sorted(places, key=frame_order):
        annotation = data.annotation(places[key])
        if annotation is not None:
            yield key, annotation


def _with_counts(annotation: Annotation, point_count: Any) -> Annotation:
    if point_count is None:
        return annotation
    return annotation.replaced(annotation.boxes.replace(point_count=point_count))


def detections_from_boxes(
    boxes: Mapping[Key, Boxes], data: Frames, *, cloud: str | None = None, progress: Progress = iter
) -> Detections:
    """Predictions made elsewhere, with what was annotated in the frames of ``data``.

    Args:
        boxes: Scored boxes by (sequence, frame), in the coordinates of ``data``.
        data: Frames; those without annotation are left out.
        cloud: A cloud whose points in the annotated boxes are counted; without one their own counts stay.
        progress: Wraps the frame numbers, to show progress.

    Raises:
        ConfigError: If there are boxes and none is of an annotated frame.
        DatasetError: If two annotated frames have one name, or nothing is annotated.
    """
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    reference, keys = "", set[Key]()
    for index in progress(range(len(data))):
        frame = data[index]
        keys.add(frame.key)
        if frame.annotation is not None:
            _once(frame, conditions)
            counts = None if cloud is None else points_in(frame.annotation, frame.cloud(cloud))
            annotations[frame.key] = _with_counts(frame.annotation, counts)
            conditions[frame.key], reference = frame.conditions, frame.reference
    notes = _without_partner(boxes, annotations, keys)
    return Detections(
        notes=notes,
        **_data_names(data),
        reference=reference,
        cloud=cloud,
        drives=data.drives() if isinstance(data, Dataset) else (),
        boxes={key: each for key, each in boxes.items() if key in annotations},
        annotations=annotations,
        conditions=conditions,
        facts=_facts(annotations),
    )


def _without_partner(boxes: Mapping[Key, Boxes], annotated: Collection[Key], keys: Collection[Key]) -> tuple[str, ...]:
    """A note on the predictions of frames that the data do not have."""
    unknown = [key for key in boxes if key not in keys]
    if boxes and annotated and not any(key in annotated for key in boxes):
        raise ConfigError(
            f"expected predictions in annotated frames, got none: predictions hold {next(iter(boxes))}, annotated is "
            f"{next(iter(annotated))}. Sequence and frame must be the same text in both."
        )
    if not unknown:
        return ()
    return (f"{len(unknown)} of {len(boxes)} frames of the predictions, such as {unknown[0]}, are not in the data",)


def _facts(annotations: Mapping[Key, Annotation]) -> dict[str, str]:
    versions = sorted({annotation.version for annotation in annotations.values()} - {""})
    return {"label_version": " and ".join(versions)} if versions else {}


def _where(data: Any) -> str:
    return str(getattr(data, "root", "detect"))


def median_ms(found: Detections) -> float:
    """Median time that a frame took from points to boxes, milliseconds; NaN without frames."""
    return float(np.median(found.ms)) if found.ms else float("nan")
