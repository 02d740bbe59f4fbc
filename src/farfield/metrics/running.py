"""Metrics that are updated frame by frame, in any training loop: ``update``, ``compute``, ``merge``, ``reset``.

>>> import numpy as np
>>> metric = running_metric("dds", replicates=0)
>>> rows = np.array([[20.0, 1.0, -1.0, 4.4, 1.9, 1.6, 0.0]])
>>> metric.update(np.column_stack([rows, [0.9]]), rows)
>>> round(metric.compute().figures["dds/0/dds"], 3)
1.0
"""

import sys
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.frame import Frame
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.boxes_of import boxes_of
from farfield.metrics.detections import PROTOCOLS, Detections
from farfield.metrics.frames import frame_order
from farfield.metrics.result import Result


class RunningMetric:
    """A protocol's score of the frames that were given so far: that of :func:`farfield.metrics.score`, digit by digit.

    Args:
        variant: What follows the colon in the protocol's name, such as a variant of ``kradar-compat``.
        label: Class of arrays that name none; also the class that is scored, where the protocol scores one.
        classes: Names by number, where labels are numbers, as in torchmetrics.
        sync: Let :meth:`compute` take the frames of all processes of torch.distributed, where that is in use.
        **settings: The protocol's settings, such as ``range_bins_m``, ``region``, ``replicates``.

    Raises:
        ConfigError: If there is no such protocol or setting.
    """

    protocol = "dds"

    def __init__(
        self,
        variant: str = "",
        *,
        label: str | None = None,
        classes: Sequence[str] = (),
        sync: bool = True,
        **settings: Any,
    ) -> None:
        self.name = f"{self.protocol}:{variant}" if variant else self.protocol
        self.label, self.names, self.sync, self.settings = label, tuple(classes), sync, settings
        options = PROTOCOLS[self.name].options()
        unknown = sorted(set(settings) - {*options, "replicates", "seed", "options"})
        if unknown:
            raise ConfigError(f"{self.name}: expected settings among {', '.join(options)}; got {', '.join(unknown)}")
        self.reset()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self._annotations)} frames)"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the protocol's name: its class is made when it is asked for."""
        return _rebuilt, (self.protocol, dict(vars(self)))

    def __len__(self) -> int:
        """Number of frames so far."""
        return len(self._annotations)

    def reset(self) -> None:
        """Forget all frames."""
        self._predicted: dict[Key, Boxes] = {}
        self._annotations: dict[Key, Annotation] = {}
        self._conditions: dict[Key, Mapping[str, str]] = {}
        self._unnamed, self._merged = 0, False

    def update(
        self,
        predicted: Any,
        annotated: Any,
        *,
        frames: Any = None,
        sequences: Any = None,
        conditions: Any = None,
    ) -> None:
        """Take one frame, or the frames of a batch in lists of equal length.

        Args:
            predicted: Scored boxes: :class:`Boxes`, an array (n, 8), a dictionary of boxes, scores and labels, a table;
                see :func:`farfield.geometry.boxes_of.boxes_of`.
            annotated: Annotated boxes likewise, without scores; also an :class:`Annotation` or a :class:`Frame`.
            frames: Name of the frame, or names (default: numbered).
            sequences: Name of its sequence, or names; needed for tracks of several drives.
            conditions: Weather, road and time by name, or a list of such.

        Raises:
            ConfigError: If boxes are none, lists differ in length, or a frame comes twice with other boxes.
        """
        if isinstance(predicted, list | tuple) and not _is_rows(predicted):
            count = len(predicted)
            columns = [predicted, annotated, *(_each(v, count) for v in (frames, sequences, conditions))]
            lengths = [len(column) if isinstance(column, list | tuple) else -1 for column in columns]
            if set(lengths) != {count}:
                raise ConfigError(
                    f"update: expected lists of {count} frames each, got {', '.join(str(v) for v in lengths[1:])}"
                )
            for one in zip(*columns, strict=True):
                self._take(*one)
        else:
            self._take(predicted, annotated, frames, sequences, conditions)

    def _take(self, predicted: Any, annotated: Any, frame: Any, sequence: Any, conditions: Any) -> None:
        label = self.label or "vehicle"
        boxes = boxes_of(predicted, "predicted", scored=True, label=label, classes=self.names)
        key = None if frame is None else (str(sequence or ""), str(frame))
        if isinstance(annotated, Frame):
            key, conditions = key or annotated.key, conditions or annotated.conditions
            annotated = annotated.annotation
            if annotated is None:
                raise ConfigError(f"update: expected an annotated frame, got one without annotation, {key}")
        if not isinstance(annotated, Annotation):
            truth = boxes_of(annotated, "annotated", scored=False, label=label, classes=self.names)
            annotated = Annotation(boxes=truth.replace(score=None))
        if key is None:
            key = (str(sequence or ""), f"unnamed {self._unnamed:09d}")
            self._unnamed += 1
        self._add(key, boxes, annotated, dict(conditions or {}))

    def _add(self, key: Key, boxes: Boxes, annotation: Annotation, conditions: Mapping[str, str]) -> None:
        if key in self._annotations:
            if _equal(boxes, self._predicted[key]) and _equal(annotation.boxes, self._annotations[key].boxes):
                return  # as a sampler repeats frames, so that all processes have equally many
            raise ConfigError(f"frame {key}: expected each frame once, got it again with other boxes")
        self._predicted[key], self._annotations[key] = boxes, annotation
        if conditions:
            self._conditions[key] = conditions

    def merge(self, *others: "RunningMetric") -> "RunningMetric":
        """A metric of this one's frames and of others', such as those of other processes; frames by their names.

        Frames that were numbered here are numbered on. The order of the whole is that of names, whatever the parts.

        Args:
            others: Metrics of the same protocol; they pickle.

        Raises:
            ConfigError: If one is of another protocol or has other settings, or a frame comes twice with other boxes.
        """
        merged = type(self)(label=self.label, classes=self.names, sync=self.sync, **self.settings)
        merged.name = self.name
        for part in (self, *others):
            if (part.name, part.settings, part.label) != (self.name, self.settings, self.label):
                raise ConfigError(f"merge: expected metrics of {self.name} with equal settings, got {part.name}")
            for key, annotation in part._annotations.items():
                own = key
                if key[1].startswith("unnamed "):
                    own = (key[0], f"unnamed {merged._unnamed:09d}")
                    merged._unnamed += 1
                merged._add(own, part._predicted[key], annotation, part._conditions.get(key, {}))
        merged._merged = True
        return merged

    def detections(self) -> Detections:
        """The frames so far, as what scores are made of.

        Raises:
            ConfigError: If there was no frame.
        """
        if not self._annotations:
            raise ConfigError(f"{type(self).__name__}: expected frames, got none yet. Call update first.")
        keys = sorted(self._annotations, key=frame_order) if self._merged else list(self._annotations)
        return Detections(
            boxes={key: self._predicted[key] for key in keys},
            annotations={key: self._annotations[key] for key in keys},
            conditions=dict(self._conditions),
        )

    def compute(self) -> Result:
        """The score of all frames so far, of all processes where torch.distributed is in use.

        Raises:
            ConfigError: If there was no frame, or a setting is impossible.
        """
        whole = _of_all_processes(self) if self.sync else self
        settings = dict(self.settings)
        if self.label is not None and "label" in PROTOCOLS[self.name].options():
            settings["label"] = self.label
        return whole.detections().score(self.name, **settings)

    def __call__(self, predicted: Any, annotated: Any, **names: Any) -> Result:
        """Take frames as :meth:`update` does, and score these alone."""
        self.update(predicted, annotated, **names)
        alone = type(self)(label=self.label, classes=self.names, sync=False, **self.settings)
        alone.name = self.name
        alone.update(predicted, annotated, **names)
        return alone.compute()


def running_metric(protocol: str, **arguments: Any) -> RunningMetric:
    """The metric of any protocol, a registered one too.

    Args:
        protocol: Such as ``"dds"`` or ``"kradar-compat:rtnh_wide"``.
        **arguments: Those of :class:`RunningMetric`.

    Raises:
        ConfigError: If there is no such protocol.
    """
    kind, _, variant = protocol.partition(":")
    return metric_class(kind)(variant, **arguments)


@cache
def metric_class(protocol: str) -> type[RunningMetric]:
    """The class of a protocol's metric.

    Args:
        protocol: The protocol, without a variant.
    """
    about = f"The protocol {protocol} in a loop; arguments and methods are those of RunningMetric."
    return type(f"Metric[{protocol}]", (RunningMetric,), {"protocol": protocol, "__doc__": about})


def _rebuilt(protocol: str, state: Mapping[str, Any]) -> RunningMetric:
    """A metric that was pickled."""
    kind = metric_class(protocol)
    metric = kind.__new__(kind)
    vars(metric).update(state)
    return metric


def _of_all_processes(metric: RunningMetric) -> RunningMetric:
    """The metric merged over the processes of torch.distributed; itself where that is not in use.

    Torch is not imported here: where no one else did, there are no processes of it.
    """
    distributed: Any = sys.modules.get("torch.distributed")
    if distributed is None or not distributed.is_available() or not distributed.is_initialized():
        return metric
    parts: list[Any] = [None] * distributed.get_world_size()
    distributed.all_gather_object(parts, metric)
    return metric if len(parts) == 1 else parts[0].merge(*parts[1:])


def _is_rows(value: Sequence[Any]) -> bool:
    """Whether a list is the rows of one frame: lists of numbers."""
    return bool(value) and isinstance(value[0], list | tuple) and all(np.isscalar(item) for item in value[0])


def _each(value: Any, count: int) -> Sequence[Any]:
    """A name or mapping for each frame of a batch."""
    if value is None or isinstance(value, str | Mapping):
        return [value] * count
    return list(value)


def _equal(one: Boxes, other: Boxes) -> bool:
    same = len(one) == len(other) and np.array_equal(one.to_numpy(), other.to_numpy())
    scores = [boxes.score if boxes.score is not None else np.zeros(len(boxes)) for boxes in (one, other)]
    return same and np.array_equal(one.label, other.label) and np.array_equal(scores[0], scores[1])
