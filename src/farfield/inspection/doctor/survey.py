"""What the doctor reads, once, of a data set, and the findings and the report that come of it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import blake2b
from os import SEEK_END
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.files.limits import open_file
from farfield.frame import Boxes, Cloud, Frame
from farfield.frame.cloud import CLOUD_SUFFIXES
from farfield.jobs import HERE, JobOptions, Unit, UnitResult, blocks, values

# What the doctor finds, and how it prints.

Severity = Literal["ok", "open", "warn", "fail"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing found.

    Args:
        severity: ``"ok"``, ``"open"`` (read as documented, and the data do not decide it), ``"warn"`` (training runs,
            look at it) or ``"fail"`` (training would fail or score zero).
        topic: Short name, such as ``"size order"``.
        what: What was found.
        where: File or frame.
        fix: How to fix it.
        absent: Whether it says no more than that something is not there, which nothing needs.
    """

    severity: Severity
    topic: str
    what: str
    where: str = ""
    fix: str = ""
    absent: bool = False


@dataclass(frozen=True, kw_only=True)
class DoctorReport:
    """All findings about one data set.

    Args:
        path: Root of the data set.
        format: Name of its format.
        findings: In the order of the examination.
        facts: Figures by name, for programs: counts, orders, classes by range.
    """

    path: str
    format: str
    findings: tuple[Finding, ...]
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether training would fail or score zero."""
        return any(finding.severity == "fail" for finding in self.findings)

    @property
    def present(self) -> tuple[Finding, ...]:
        """The findings about what is there, or should be."""
        return tuple(finding for finding in self.findings if not finding.absent)

    @property
    def absent(self) -> tuple[str, ...]:
        """Topics of what is not there and need not be."""
        return tuple(finding.topic for finding in self.findings if finding.absent)

    def to_json(self) -> dict[str, Any]:
        """Return plain values: path, format, failed, facts, findings."""
        findings = [
            {"mend" if name == "fix" else name: value for name, value in asdict(finding).items()}
            for finding in self.findings
        ]
        return {"path": self.path, "format": self.format, "failed": self.failed, "facts": self.facts} | {
            "findings": findings
        }

    def __str__(self) -> str:
        lines = [f"{self.path}: {self.format}"]
        for finding in self.present:
            where = f" [{finding.where}]" if finding.where else ""
            fix = f"\n       fix: {finding.fix}" if finding.fix else ""
            lines.append(f"{finding.severity:>5}  {finding.topic}: {finding.what}{where}{fix}")
        return "\n".join([*lines, *([f"not there: {', '.join(self.absent)}"] if self.absent else [])])


_PART_BYTES = 4096
_BLOCK = 10  # frames that a worker reads at a time


@dataclass(frozen=True, eq=False, kw_only=True)
class SurveyFrame:
    """One frame whose clouds were read: its key, clouds by name, and boxes (None where not annotated)."""

    key: tuple[str, str]
    clouds: dict[str, Cloud]
    boxes: Boxes | None

    @property
    def points_m(self) -> Float[np.ndarray, "n 3"]:
        """Points of the cloud that the boxes belong to: the first that is no radar's."""
        first = next((cloud for name, cloud in self.clouds.items() if not name.startswith("radar")), None)
        return np.zeros((0, 3)) if first is None else first.points_m.astype(np.float64)


class FrameFacts(NamedTuple):
    """A frame's (sequence, frame), its time and its pose in the world, shape (4, 4), both None where not known."""

    key: tuple[str, str]
    time_ns: int | None
    world_T_frame: Float[np.ndarray, "4 4"] | None


@dataclass(kw_only=True)
class SurveyBlock:
    """What some frames hold.

    Args:
        sensors: Number of frames with each cloud, by name.
        images: Number of frames with each image.
        cameras: Names of calibrated cameras.
        times_ns: Time of each frame, None where unknown.
        sensor_times_ns: Times of each frame's sensors, by name, where they are known.
        pair_dt_ms: Uniform minus Gaussian times of the paired frames.
        boxes: Boxes of every annotated frame.
        box_frames: Which frames these are.
        image_sizes: Frames by image's name, width and height, and those for which the frame's camera is calibrated, of
            those whose clouds were read.
        clouds_by_digest: Paths of all frames' cloud files by a digest of their size, beginning and end.
        raw_labels: How often each class name stands in the files, where a reader tells.
        unlabelled: Number of frames without annotation.
        samples: Frames whose clouds were read.
        damaged: Errors met, one a frame or cloud.
    """

    sensors: dict[str, int] = field(default_factory=dict)
    images: dict[str, int] = field(default_factory=dict)
    cameras: set[str] = field(default_factory=set)
    times_ns: list[int | None] = field(default_factory=list)
    sensor_times_ns: list[dict[str, int]] = field(default_factory=list)
    pair_dt_ms: list[float] = field(default_factory=list)
    boxes: list[Boxes] = field(default_factory=list)
    box_frames: list[FrameFacts] = field(default_factory=list)
    image_sizes: dict[tuple[str, int, int, int, int], list[str]] = field(default_factory=dict)
    clouds_by_digest: dict[str, list[str]] = field(default_factory=dict)
    raw_labels: dict[str, int] = field(default_factory=dict)
    unlabelled: int = 0
    samples: list[SurveyFrame] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)

    def extend(self, others: "SurveyBlock") -> None:
        """Append what further frames hold."""
        for own, other in ((self.sensors, others.sensors), (self.images, others.images)):
            for name, count in other.items():
                own[name] = own.get(name, 0) + count
        for name, count in others.raw_labels.items():
            self.raw_labels[name] = self.raw_labels.get(name, 0) + count
        self.cameras |= others.cameras
        self.times_ns += others.times_ns
        self.sensor_times_ns += others.sensor_times_ns
        self.pair_dt_ms += others.pair_dt_ms
        self.boxes += others.boxes
        self.box_frames += others.box_frames
        for name_and_size, frames in others.image_sizes.items():
            self.image_sizes.setdefault(name_and_size, []).extend(frames)
        for digest, paths in others.clouds_by_digest.items():
            self.clouds_by_digest.setdefault(digest, []).extend(paths)
        self.unlabelled += others.unlabelled
        self.samples += others.samples
        self.damaged += others.damaged


@dataclass(kw_only=True)
class Survey(SurveyBlock):
    """What was read of a whole data set.

    Args:
        dataset: The data set.
    """

    dataset: Dataset

    def all_boxes(self) -> Boxes:
        """All annotated boxes of all frames."""
        return Boxes.concatenate([boxes.plain() for boxes in self.boxes]) if self.boxes else Boxes.empty()

    def annotated_samples(self) -> Iterator[tuple[SurveyFrame, Boxes]]:
        """Samples with a LiDAR's cloud and at least one box."""
        for sample in self.samples:
            if (
                sample.boxes is not None
                and len(sample.boxes)
                and not all(name.startswith("radar") for name in sample.clouds)
            ):
                yield sample, sample.boxes


@dataclass(frozen=True)
class _BlockSurvey:
    """Reads a block of frames, the clouds of some of them."""

    dataset: Dataset
    chosen: frozenset[int]
    memory_bytes = 800_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        block = SurveyBlock()
        for index in unit.parameters:
            try:
                frame = self.dataset[index]
            except (FarfieldError, OSError, ValueError) as error:
                block.damaged.append(str(error))
                block.times_ns.append(None)
                block.sensor_times_ns.append({})
                continue
            _count_sensors(block, frame)
            _digest_files(block, self.dataset.files(index))
            boxes = _boxes(block, frame)
            if index in self.chosen:
                _measure_images(block, frame)
                block.samples.append(SurveyFrame(key=frame.key, clouds=_clouds(block, frame), boxes=boxes))
        return UnitResult(value=block)


def survey(dataset: Dataset, *, max_clouds: int = 20, bulk: JobOptions = HERE) -> Survey:
    """Read all annotations and the clouds of some frames, spread evenly.

    Args:
        dataset: The data set.
        max_clouds: Number of frames whose clouds are read; 0 reads all.
        bulk: Who reads.
    """
    result, count = Survey(dataset=dataset), len(dataset)
    spread = np.linspace(0, count - 1, min(count, max_clouds or count))
    chosen = frozenset(spread.round().astype(int).tolist())
    for block in values(_BlockSurvey(dataset, chosen), blocks(count, _BLOCK), bulk):
        result.extend(block.value)
    return result


def _count_sensors(block: SurveyBlock, frame: Frame) -> None:
    for name in frame.clouds:
        block.sensors[name] = block.sensors.get(name, 0) + 1
    for name in frame.images:
        block.images[name] = block.images.get(name, 0) + 1
    block.cameras |= set(frame.cameras)
    block.times_ns.append(frame.time_ns)
    times_by_sensor = {name: sensor.time_ns for name, sensor in frame.sensors.items() if sensor.time_ns is not None}
    block.sensor_times_ns.append(times_by_sensor)
    times = [frame.sensors[name].time_ns for name in ("gaussian", "uniform") if name in frame.sensors]
    if len(times) == 2 and times[0] is not None and times[1] is not None:
        block.pair_dt_ms.append((times[1] - times[0]) / 1e6)


def _boxes(block: SurveyBlock, frame: Frame) -> Boxes | None:
    try:
        annotation = frame.annotation
        if annotation is None:
            block.unlabelled += 1
            return None
        boxes = annotation.boxes
        for name in annotation.original_label or ():
            block.raw_labels[str(name)] = block.raw_labels.get(str(name), 0) + 1
    except (FarfieldError, OSError, ValueError) as error:
        block.damaged.append(str(error))
        return None
    block.boxes.append(boxes)
    block.box_frames.append(FrameFacts(frame.key, frame.time_ns, frame.world_T_frame))
    return boxes


def _digest_files(block: SurveyBlock, paths: Sequence[Path]) -> None:
    """Digests that are equal for files of equal content, and hardly for others; of small parts, for all frames."""
    for path in paths:
        if path.suffix.lower() not in CLOUD_SUFFIXES:
            continue
        try:
            with open_file(path, max_bytes=None) as handle:
                size = handle.seek(0, SEEK_END)
                handle.seek(0)
                parts = [handle.read(_PART_BYTES)]
                for at in (size // 2, max(size - _PART_BYTES, 0)):
                    handle.seek(at)
                    parts.append(handle.read(_PART_BYTES))
        except (OSError, FarfieldError):
            continue  # reported where the cloud is read
        digest = blake2b(b"".join([str(size).encode(), *parts]), digest_size=16).hexdigest()
        block.clouds_by_digest.setdefault(digest, []).append(str(path))


def _measure_images(block: SurveyBlock, frame: Frame) -> None:
    """Sizes of the images whose cameras say for what size they are calibrated."""
    for name, camera in frame.cameras.items():
        if name not in frame.images or not camera.width_px:
            continue
        try:
            height, width = frame.images[name].shape[:2]
        except (FarfieldError, OSError, ValueError) as error:
            block.damaged.append(str(error))
            continue
        sizes = (name, width, height, camera.width_px, camera.height_px)
        block.image_sizes.setdefault(sizes, []).append("/".join(frame.key))


def _clouds(block: SurveyBlock, frame: Frame) -> dict[str, Cloud]:
    clouds: dict[str, Cloud] = {}
    for name in frame.clouds:
        try:
            clouds[name] = frame.clouds[name]
        except (FarfieldError, OSError, ValueError) as error:
            block.damaged.append(str(error))
    return clouds
