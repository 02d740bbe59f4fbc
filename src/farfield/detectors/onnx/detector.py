"""A detector from an exported file, run by onnxruntime: a detector like any other, without torch."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from farfield.detectors.onnx.readings import DecodedBoxes, Tensors
from farfield.detectors.onnx.record import record_of
from farfield.detectors.onnx.wire import MAX_BYTES, TensorSpec, read_content
from farfield.detectors.suppression import rotated_nms
from farfield.detectors.trained import ChosenClasses, Classes, TrainedDetector, cloud_rows
from farfield.errors import ConfigError, FarfieldError, FileFormatError, MissingExtraError, plain
from farfield.files.atomic import read_bytes
from farfield.frame import Cloud, Frame
from farfield.geometry.boxes import Boxes
from farfield.jobs.process import usable_cores

SUFFIX = ".onnx"
_BEFORE_CALIBRATION = 5000


@dataclass(frozen=True)
class RuntimeDevice:
    """Where onnxruntime runs."""

    type: str = "cpu"

    def __str__(self) -> str:
        return self.type


@dataclass(frozen=True, kw_only=True)
class OnnxSettings:
    """Settings of an exported detector, as those of a network that the verbs look at."""

    name: str
    class_names: tuple[str, ...]
    reach_m: float
    score_threshold: float
    nms_iou: float
    max_boxes: int
    score_bands: Any


class OnnxDetector(TrainedDetector):
    """An exported network that turns frames into boxes.

    Args:
        path: The file.
        device: ``None``, ``"auto"`` or ``"cpu"``.
        precision: ``"auto"`` or ``"fp32"``.
        cloud: Which of a frame's clouds to read.
        score_threshold: Boxes below are not given (default: this and the following are the file's own).
        nms_iou: Boxes that overlap a better one by more are not given.
        max_boxes: Boxes given in a frame.
        classes: Classes to give, or for each of them the name to give it.
        calibrated: Whether scores are calibrated, where the file holds how.
        threads: Threads of the network; as many as OMP_NUM_THREADS says, or the cores that this process may use.
        optimised: Let onnxruntime fuse operators.

    Raises:
        FileFormatError: If the file is none that ``farfield export`` writes, is damaged, or holds what none of ours
            does (see :mod:`farfield.detectors.onnx.wire`).
        ConfigError: If a choice is not possible.
        MissingExtraError: If onnxruntime is not installed.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        device: Any = None,
        precision: str = "auto",
        cloud: str | Mapping[str, str] | None = None,
        score_threshold: float | None = None,
        nms_iou: float | None = None,
        max_boxes: int | None = None,
        classes: Classes | None = None,
        calibrated: bool = True,
        threads: int | None = None,
        optimised: bool = True,
    ) -> None:
        if str(device or "auto") not in ("auto", "cpu") or precision not in ("auto", "fp32"):
            raise ConfigError(
                f"{path}: expected device auto or cpu and precision auto or fp32, for which the file was exported; got "
                f"{device} and {precision}."
            )
        self.path, self.threads, self.optimised = Path(path), threads, optimised
        if not self.path.is_file():
            raise FarfieldError(f"{path}: expected an exported detector, found nothing. Make one with: farfield export")
        data = read_bytes(self.path, max_bytes=MAX_BYTES)
        content = read_content(self.path, data)
        self.record, self.provenance = record_of(self.path, content)
        self._specs, self._gives = content.inputs, frozenset(content.outputs)
        self._sha256 = hashlib.sha256(data).hexdigest()
        self.device, self.precision, self.why_precision = RuntimeDevice(), "fp32", "the file's number type"
        self.cloud, self._name, record = cloud, self.record.name, self.record
        count = record.max_boxes if max_boxes is None else max_boxes
        most = count if classes is None else max(count, record.max_boxes)  # chosen among all boxes, then counted
        self._config = OnnxSettings(
            name=record.detector,
            class_names=record.classes,
            reach_m=record.reach_m,
            score_threshold=_within("score_threshold", score_threshold, record.score_threshold),
            nms_iou=_within("nms_iou", nms_iou, record.nms_iou),
            max_boxes=most,
            score_bands=record.score_bands if calibrated else None,
        )
        if count < 1:
            raise ConfigError(f"max_boxes: expected 1 or more, got {max_boxes}.")
        self.chosen = None if classes is None else ChosenClasses.of(classes, record.classes, count)
        self._session = _session(self.path, data, threads, optimised)

    @classmethod
    def load(cls, name: str | Path, **options: Any) -> "OnnxDetector":
        """Load an exported file."""
        return cls(name, **options)

    @property
    def config(self) -> OnnxSettings:
        """Its settings."""
        return self._config

    @property
    def read_columns(self) -> Mapping[str, Sequence[str]]:
        """Columns of each cloud that it reads, by the name of the network's input."""
        return {"points": self.record.reading.columns}

    @property
    def network_name(self) -> str:
        """Class of the network that was exported."""
        return self.record.network

    @property
    def reference(self) -> str | None:
        """Name of the sensor in whose coordinates it learnt; None where that is not known."""
        return self.record.reference

    def __repr__(self) -> str:
        """Its name, kind and classes."""
        return (
            f"OnnxDetector({self.name}: {self.record.detector} to {self.reach_m:g} m; classes "
            f"{', '.join(self.class_names)}; reads {', '.join(self.columns)} of a {self.kind}; scores from "
            f"{self.config.score_threshold:g}; fp32 by onnxruntime)"
        )

    def __getstate__(self) -> dict[str, Any]:
        """All but the session, which another process makes of the file anew."""
        return {name: value for name, value in vars(self).items() if name != "_session"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the session anew; the file must be the same."""
        vars(self).update(state)
        data = read_bytes(self.path, max_bytes=MAX_BYTES)
        if hashlib.sha256(data).hexdigest() != self._sha256:
            raise FileFormatError(self.path, where="bytes", expected="the file that was loaded", got="another one")
        self._session = _session(self.path, data, self.threads, self.optimised)

    def with_cloud(self, cloud: str | Mapping[str, str] | None) -> "OnnxDetector":
        """The same detector reading another of a frame's clouds; the session is shared."""
        other = object.__new__(OnnxDetector)
        vars(other).update(vars(self) | {"cloud": cloud})
        return other

    def digest(self) -> str:
        """SHA-256 of all that decides its boxes: the file and the choices."""
        config = self._config
        named = None if self.chosen is None else [dict(self.chosen.names), self.chosen.max_boxes]
        numbers = [config.score_threshold, config.nms_iou, config.max_boxes, config.score_bands is not None]
        text = json.dumps([self._sha256, numbers, named, self.cloud], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    def detect(self, frames: Sequence[Frame | Cloud]) -> list[Boxes]:
        """Detect objects in frames, one after the other.

        Raises:
            ConfigError: If a frame has no cloud of the kind and with the columns that it reads.
            FarfieldError: If the network gives what is not a number, or does not run.
        """
        return [self.finished(points, self.candidates(points)) for points in map(self.points_of, frames)]

    def points_of(self, frame: Frame | Cloud) -> np.ndarray:
        """What the network reads of a frame, before it is prepared: rows of its columns."""
        return cloud_rows(self._clouds(frame)["points"], self.record.reading.columns)

    def candidates(self, points: np.ndarray) -> DecodedBoxes:
        """Decoded boxes before the suppression."""
        return self.record.reading.detect(points, self.run)

    def run(self, tensors: Tensors) -> Tensors:
        """Ask the network; an input of the other half of its graph that is not there has no rows.

        Raises:
            FarfieldError: If it does not run, such as for want of memory, or gives other shapes than its record says.
        """
        feeds = {name: tensors[name] if name in tensors else _no_rows(spec) for name, spec in self._specs.items()}
        results = [*self.record.reading.results, *(["index"] if "index" in self._gives else [])]
        try:
            outputs = self._session.run(results, feeds)
        except Exception as error:  # onnxruntime's errors have no common base
            raise FarfieldError(f"{self.path}: the network does not run: {plain(error)[:300]}") from error
        named = dict(zip(results, outputs, strict=True))
        self._check_shapes(tensors, named)
        return named

    def _check_shapes(self, tensors: Tensors, outputs: Tensors) -> None:
        """See that outputs have the sides of their kinds, and rows that belong together are as many."""
        rows: dict[str, int] = {}
        for name, values in outputs.items():
            kind, sides, together = _GIVEN[name]
            expected = tuple(len(self.record.classes) if side == "classes" else side for side in sides)
            count = len(values) if values.ndim else 0
            if together in tensors:
                rows.setdefault(together, len(tensors[together]))
            if (
                values.dtype.kind != kind
                or values.ndim != len(expected) + 1
                or any(side not in (None, own) for side, own in zip(expected, values.shape[1:], strict=True))
                or rows.setdefault(together, count) != count
            ):
                shape = (rows.get(together, "n"), *("any" if side is None else side for side in expected))
                words = f"{'integers' if kind == 'i' else 'numbers'} of shape ({', '.join(map(str, shape))})"
                got = f"{values.dtype} of {values.shape}"
                fix = "Export the detector anew: farfield export DETECTOR OUT.onnx"
                raise FileFormatError(self.path, where=f"output {name}", expected=words, got=got, fix=fix)

    def finished(self, points: np.ndarray, candidates: DecodedBoxes) -> Boxes:
        """Scored boxes, best first: those above the threshold, after suppression, calibrated, of the chosen classes.

        Args:
            points: What the network read.
            candidates: What it gave.
        """
        config, bands = self._config, self._config.score_bands
        rows, score, kind = candidates
        if not (np.isfinite(score).all() and np.isfinite(rows).all()):
            raise FarfieldError(
                f"{self.path}: expected scores, got what is not a number: the file is damaged, or a cloud holds absurd "
                "values."
            )
        least = config.score_threshold if bands is None else bands.least_score(config.score_threshold)
        keep = (score >= least) & (score > 0)
        rows, score, kind = rows[keep], score[keep], kind[keep]
        if not ((rows[:, 3:6] > 0).all() and ((kind >= 0) & (kind < len(self.record.classes))).all()):
            raise FarfieldError(f"{self.path}: expected boxes with sizes above 0, of its classes; the file is damaged.")
        boxes = Boxes(
            centre_m=rows[:, :3],
            size_m=rows[:, 3:6],
            yaw_rad=rows[:, 6],
            label=np.array(self.record.classes, dtype=np.str_)[kind.astype(np.int64)],
            score=score,
        )
        limit = config.max_boxes if bands is None else max(config.max_boxes, _BEFORE_CALIBRATION)
        boxes = boxes[rotated_nms(boxes, iou_threshold=config.nms_iou, limit=limit)]
        boxes = boxes if bands is None else self._calibrated(boxes, points[:, :3])
        return boxes if self.chosen is None else self.chosen(boxes)


_GIVEN: Mapping[str, tuple[str, tuple[int | str | None, ...], str]] = {
    "boxes": ("f", (7,), "boxes"),
    "scores": ("f", (), "boxes"),
    "labels": ("i", (), "boxes"),
    "index": ("i", (), "boxes"),
    "heat": ("f", ("classes",), "boxes"),
    "confidence": ("f", ("classes",), "boxes"),
    "votes": ("f", (3,), "heights"),
    "map_out": ("f", (None,), "heights"),
    "foreground": ("f", ("classes",), "xyz"),
    "proposed": ("f", (7,), "xyz"),
    "semantic_out": ("f", (None,), "xyz"),
}
"""What exported networks give: kind of number, sides after the first, and the input or output with as many rows."""


def _within(name: str, value: float | None, own: float) -> float:
    if value is None:
        return own
    if not 0 <= value <= 1:
        raise ConfigError(f"{name}: expected 0 to 1, got {value}.")
    return float(value)


def _no_rows(spec: TensorSpec) -> np.ndarray:
    return np.zeros((0, *(side or 1 for side in spec.shape[1:])), dtype=spec.dtype)


def _session(path: Path, data: bytes, threads: int | None, optimised: bool) -> Any:
    """A session of onnxruntime on the CPU, of bytes that were checked: no other file is opened."""
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise MissingExtraError("onnxruntime", "onnx", "Running an exported detector") from error
    options = onnxruntime.SessionOptions()
    own = os.environ.get("OMP_NUM_THREADS", "")
    options.intra_op_num_threads = threads or (int(own) if own.isdecimal() and int(own) else usable_cores())
    options.inter_op_num_threads, options.enable_mem_pattern = 1, False
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # two processes would starve each other
    options.log_severity_level = 4  # errors are raised, with their words
    if not optimised:
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise FileFormatError(path, where="graph", expected="a network that runs", got=plain(error)[:300]) from error
