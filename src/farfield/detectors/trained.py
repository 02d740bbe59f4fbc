"""What every trained detector is, whatever runs it: what it learnt from, which cloud it reads, which boxes it gives.

Needs no torch.
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Float32

from farfield.detectors.info import DetectorInfo
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame
from farfield.frame.cloud import RADAR_COLUMNS
from farfield.frame.door import frame_of
from farfield.geometry.boxes import BOX_MARGIN_M, Boxes, count_points_in_boxes
from farfield.registry import display_html

# Which of its boxes a detector gives, by score, overlap, number and class: chosen as it is loaded, not trained.

Classes = Iterable[str] | Mapping[str, str]
"""Classes to give, or for each of them the name to give it."""


@dataclass(frozen=True)
class ChosenClasses:
    """Some of a detector's classes, perhaps under other names.

    Args:
        names: The name to give each chosen class.
        max_boxes: Boxes of the chosen classes that are kept in a frame.
    """

    names: Mapping[str, str]
    max_boxes: int

    @classmethod
    def of(cls, choice: Classes, class_names: tuple[str, ...], max_boxes: int) -> "ChosenClasses":
        """Check a choice.

        Args:
            choice: The choice.
            class_names: The detector's own classes.
            max_boxes: As of the class.

        Raises:
            ConfigError: If it names none, or one that the detector does not know.
        """
        names = dict(choice) if isinstance(choice, Mapping) else {name: name for name in choice}
        unknown = [name for name in names if name not in class_names]
        if unknown or not names or not all(names.values()):
            raise ConfigError(
                f"classes: expected at least one class that the detector knows ({', '.join(class_names)}), each with "
                f"the name to give it or none; got {', '.join(unknown or names) or 'none'}."
            )
        return cls(names, max_boxes)

    @property
    def given(self) -> tuple[str, ...]:
        """The names that boxes can have."""
        return tuple(dict.fromkeys(self.names.values()))

    def __call__(self, boxes: Boxes) -> Boxes:
        """The boxes of these classes, under the names to give."""
        chosen = boxes[np.isin(boxes.label, list(self.names))][: self.max_boxes]
        labels = np.array([self.names[str(name)] for name in chosen.label], dtype=np.str_)
        return chosen.replace(label=labels) if len(chosen) else chosen


_FINITE = ("intensity", "power", "lag_s")
"""A point whose position, strength or age is not finite is dropped; other columns count as 0 where they are not."""


def cloud_rows(cloud: Cloud, columns: Sequence[str]) -> Float32[np.ndarray, "n columns"]:
    """A cloud as rows of the named columns, float32.

    Points whose position, strength or age is not finite are dropped, whether or not these are read; a value of another
    column that is not finite counts as 0.

    Raises:
        ConfigError: If the cloud lacks one of the columns.
    """
    rows = np.empty((len(cloud), len(columns)), dtype=np.float32)
    for number, name in enumerate(columns):
        rows[:, number] = cloud.column(name)
    strength = [cloud.column(name) for name in _FINITE if name in cloud.columns]
    if all(map(_all_finite, (cloud.points_m, rows, *strength))):
        return rows
    finite = np.isfinite(cloud.points_m).all(axis=1)
    for values in strength:
        finite &= np.isfinite(values)
    rows = rows[finite]
    return np.where(np.isfinite(rows), rows, np.float32(0.0))


def _all_finite(values: np.ndarray) -> bool:
    """Whether all are finite: a sum in float64 of float32 numbers is, unless one of them is not."""
    with np.errstate(invalid="ignore"):  # infinities of both signs
        return bool(np.isfinite(values.sum(dtype=np.float64)))


_KRADAR_LIDAR = "os2-64"
"""In whose coordinates K-Radar's frames stand unless they were moved into the radar's."""


Detector = TypeVar("Detector", bound="TrainedDetector")


class TrainedDetector(ABC):
    """A detector with a record of its training.

    A subclass sets ``provenance``, ``cloud``, ``chosen``, ``precision`` and ``_name``.
    """

    provenance: dict[str, Any]
    cloud: str | Mapping[str, str] | None
    chosen: ChosenClasses | None
    precision: str
    _name: str

    @property
    @abstractmethod
    def config(self) -> Any:
        """Its settings: name, class_names, reach_m, score_threshold, nms_iou, max_boxes and score_bands at least."""

    @property
    @abstractmethod
    def read_columns(self) -> Mapping[str, Sequence[str]]:
        """Columns of each cloud that it reads, by the name of the network's input."""

    @property
    @abstractmethod
    def network_name(self) -> str:
        """Class of its network, such as ``"PointPillars"``."""

    @property
    def name(self) -> str:
        """What it is called: its weights, or their run; without either its experiment, or its kind."""
        return self._name or str(self.provenance.get("experiment", {}).get("name", self.config.name))

    def _repr_html_(self) -> str | None:
        """What a notebook shows: where it looks, and for what."""
        return display_html("detector", self)

    @property
    def info(self) -> DetectorInfo:
        """What is known of it: what it reads, what it gives, and what it was trained on."""
        return DetectorInfo(
            name=self.name,
            network=self.network_name,
            classes=self.class_names,
            sensor=self.kind,
            columns=self.columns,
            learnt_clouds=self.learnt_clouds,
            reference=self.reference,
            reach_m=self.reach_m,
            provenance=self.provenance,
            family=str(self.provenance.get("family", "")),
            places=self.places,
            precision=self.precision,
            score_threshold=self.config.score_threshold,
            nms_iou=self.config.nms_iou,
            max_boxes=self.config.max_boxes if self.chosen is None else self.chosen.max_boxes,
        )

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes that this detector tells apart, by the names that it gives them."""
        return tuple(self.config.class_names) if self.chosen is None else self.chosen.given

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the clouds that it reads, of all inputs together."""
        return tuple(dict.fromkeys(name for columns in self.read_columns.values() for name in columns))

    @property
    def reach_m(self) -> float:
        """How far ahead it looks, metres."""
        return float(self.config.reach_m)

    @property
    def learnt_clouds(self) -> tuple[str, ...]:
        """Names of the clouds that it learnt from; none where nothing is known of its training."""
        clouds = self._trained_on.get("clouds", ())
        if isinstance(clouds, Mapping):
            clouds = [name for cloud_names in clouds.values() for name in cloud_names]
        return tuple(dict.fromkeys(clouds))

    @property
    def kind(self) -> Literal["lidar", "radar"]:
        """Of which kind of sensor its clouds are: a radar's if it reads a radar's columns or learnt from a radar."""
        of_radar = any(name.startswith(RADAR_COLUMNS) for name in self.columns)
        return "radar" if of_radar or any(name.startswith("radar") for name in self.learnt_clouds) else "lidar"

    @property
    def reference(self) -> str | None:
        """Name of the sensor in whose coordinates it learnt; None where that is not known."""
        stated = self._trained_on.get("options", {}).get("reference")
        if stated is None and _KRADAR_LIDAR in self.learnt_clouds:
            return _KRADAR_LIDAR
        return None if stated is None else str(stated)

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the real places whose sweeps it learnt from, each once."""
        donors = [stream.get("donors") or {} for stream in self.provenance.get("streams", {}).values()]
        return tuple(dict.fromkeys(str(name) for lent in donors for name in lent.get("places", ())))

    @property
    def _trained_on(self) -> dict[str, Any]:
        """The experiment's data; of several streams those that the weights are meant for, or the first one's."""
        data: dict[str, Any] = self.provenance.get("experiment", {}).get("data", {})
        several = bool(data) and "path" not in data and all(isinstance(group, dict) for group in data.values())
        return data.get(self.provenance.get("stream", ""), next(iter(data.values()))) if several else data

    def with_cloud(self: Detector, cloud: str | Mapping[str, str] | None) -> Detector:
        """The same detector reading another of a frame's clouds; weights are shared."""
        other = copy.copy(self)
        other.cloud = cloud
        return other

    @abstractmethod
    def detect(self, frames: Sequence[Frame | Cloud]) -> list[Boxes]:
        """Detect objects in a batch of frames."""

    def __call__(self, frame: Any) -> Boxes:
        """Detect objects; boxes are in the frame's coordinates, best first.

        Args:
            frame: A frame, a cloud, the path of a cloud file, an array or a table, see
                :func:`farfield.frame.door.frame_of`.

        Raises:
            ConfigError: As of :meth:`detect`, and if it is nothing of these.
        """
        return self.detect([frame if isinstance(frame, Cloud) else frame_of(frame)])[0]

    def _calibrated(self, boxes: Boxes, points_m: np.ndarray) -> Boxes:
        """The boxes with scores that count their range and points, as many and as good as are given, best first."""
        if boxes.score is None or not len(boxes):
            return boxes
        count = count_points_in_boxes(points_m, boxes, margin_m=BOX_MARGIN_M)
        score = self.config.score_bands(boxes.score, boxes.range_m, count)
        order = np.argsort(-score, kind="stable")
        rows = order[score[order] >= self.config.score_threshold][: self.config.max_boxes]
        return boxes.replace(score=score)[rows]

    def _clouds(self, frame: Frame | Cloud) -> dict[str, Cloud]:
        """The cloud of each of the network's inputs."""
        inputs = self.read_columns
        if not isinstance(frame, Cloud):
            self._check_coordinates(frame)
            return {name: self._chosen(frame, name) for name in inputs}
        if len(inputs) > 1:
            raise ConfigError(f"Expected a frame with clouds for the inputs {', '.join(inputs)}; got a single cloud.")
        return dict.fromkeys(inputs, frame)

    def _chosen(self, frame: Frame, source: str) -> Cloud:
        """The cloud of an input: the chosen one, or the first one learnt from that is there, or the first that fits."""
        if isinstance(self.cloud, Mapping):
            name = self.cloud.get(source)
        elif len(self.read_columns) > 1:
            name = source
        else:
            name = self.cloud or next((name for name in self.learnt_clouds if name in frame.clouds), None)
        if name is None:
            name = next((name for name in frame.clouds if not self._misfit(frame, name, source)), None)
        if name is None or name not in frame.clouds:
            present = ", ".join(frame.clouds) or "none"
            raise ConfigError(
                f"frame {frame.key}: expected a cloud of a {self.kind} with {self._read(source)}"
                f"{'' if name is None else f', named {name!r}'}; its clouds are: {present}. "
                "Choose one with cloud=, or a detector that reads what there is."
            )
        misfit = self._misfit(frame, name, source)
        if misfit:
            fits = [other for other in frame.clouds if not self._misfit(frame, other, source)]
            raise ConfigError(
                f"frame {frame.key}, cloud {name!r}: {misfit}; the detector reads a {self.kind} with "
                f"{self._read(source)}. What fits here: {', '.join(fits) or 'no cloud'}."
            )
        cloud: Cloud = frame.cloud(name)
        return cloud

    def _read(self, source: str) -> str:
        return ", ".join(self.read_columns[source])

    def _misfit(self, frame: Frame, name: str, source: str) -> str:
        """Why an input cannot be read from a frame's cloud; empty where it can."""
        sensor = frame.sensors.get(name)
        if sensor is not None and len(self.read_columns) == 1 and sensor.kind != self.kind:
            return f"it is of a {sensor.kind}"
        if sensor is not None and not sensor.in_frame:
            return "it keeps its sensor's own coordinates"
        cloud = frame.cloud(name)
        present = (*cloud.columns, "lag_s", *(("intensity",) if cloud.kind == "lidar" else ()))
        missing = [column for column in self.read_columns[source] if column not in present]
        return f"it has no column {missing[0]!r}" if missing else ""

    def _check_coordinates(self, frame: Frame) -> None:
        stands_in, learnt = frame.reference.removesuffix("'"), self.reference
        names = {*frame.clouds, *frame.sensors}
        if learnt is None or stands_in == learnt:
            return
        if learnt in names or (learnt, stands_in) == ("radar", _KRADAR_LIDAR):
            raise ConfigError(
                f"frame {frame.key} stands in the coordinates of {frame.reference}; the detector learnt in those of "
                f"{learnt}. farfield.detect(detector, data) moves the data as it learnt to see them."
            )
