"""Running a trained network on frames: which boxes it gives, precision, folding, memory, and which clouds it reads."""

import copy
import ctypes
import hashlib
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from pydantic import ValidationError
from torch import Tensor, nn

from farfield.detectors.devices import DTYPES, chosen_device, default_precision, fitting
from farfield.detectors.info import DetectorInfo
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.layers import fold_batch_norm
from farfield.detectors.network import FIXED, Network, build_detector
from farfield.detectors.soundness import unsound
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.errors import ConfigError, plain
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


def reconfigured(network: Network, changes: Mapping[str, Any]) -> Network:
    """The same network, its weights shared, with some settings changed that no weight depends on.

    It is built anew, so that a setting counts wherever the network looks at it.

    Args:
        network: Before anything in it is folded.
        changes: Fields of its configuration.

    Raises:
        ConfigError: If a value is not possible.
    """
    if not changes:
        return network
    try:
        config = type(network.config).model_validate({**network.config.model_dump(), **changes})
    except ValidationError as error:
        raise ConfigError(f"{plain(error)}.") from error
    with torch.device("meta"):
        other = build_detector(config)
    other.load_state_dict(network.state_dict(), assign=True)
    return other.train(network.training)


@cache
def keep_freed_memory() -> bool:
    """Ask glibc to keep freed blocks instead of handing them back to the kernel; True where that worked.

    A network allocates and frees the same large feature maps at every frame. By default each of them is mapped anew and
    every page of it faults again, which costs about a third of the time of a forward pass on a CPU.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return False
    trim_threshold, top_pad, mmap_threshold = -1, -2, -3
    limit = 2**31 - 1
    return all(
        mallopt(option, value) for option, value in ((mmap_threshold, 2**30), (trim_threshold, limit), (top_pad, 2**28))
    )


def give_back_freed_memory() -> None:
    """Hand what was kept back to the kernel, holes between blocks in use too; a no-op where there is no glibc.

    Batches of other sizes leave holes that no later batch fills: a training of 3,000 steps grew to 12.6 GB with them.
    """
    if keep_freed_memory():
        ctypes.CDLL("libc.so.6").malloc_trim(0)


_TOO_LARGE = (
    "To detect in less: fewer frames at a time, precision bf16 or fp16, a detector of a shorter range or with larger "
    "cells, or device cpu."
)
_BEFORE_CALIBRATION = 5000
"""Boxes of a frame whose scores are calibrated: another order than the network's decides which are given."""
_KRADAR_LIDAR = "os2-64"
"""In whose coordinates K-Radar's frames stand unless they were moved into the radar's."""


class Detector:
    """A trained network that turns frames into boxes.

    Args:
        network: The network; a folded copy in evaluation mode is kept.
        provenance: What is known of its training.
        device: Where to run; by default, and for ``"auto"``, a GPU if there is one, else the CPU.
        precision: ``"fp32"``, ``"bf16"``, ``"fp16"`` or ``"auto"``: what the device multiplies itself, for the
            reason that ``why_precision`` gives.
        cloud: Which of a frame's clouds to read, for a network of several inputs one for each; by default one that it
            learnt from, where a frame has none of them its first that fits.
        score_threshold: Boxes below are not given; this and the following are the weights' own unless given.
        nms_iou: Boxes that overlap a better one by more are not given.
        max_boxes: Boxes given in a frame.
        classes: Classes to give, or for each of them the name to give it; all unless given. Boxes of the others still
            suppress those that they overlap.
        calibrated: Whether scores are calibrated, where the weights hold how.
        name: What to call it.

    Raises:
        ConfigError: If the precision is unknown, there is no such device, a limit is not possible or the network does
            not know a class.
        OutOfMemory: If the network does not fit into the device's memory.
    """

    def __init__(
        self,
        network: Network,
        *,
        provenance: dict[str, Any] | None = None,
        device: str | torch.device | None = None,
        precision: str = "auto",
        cloud: str | Mapping[str, str] | None = None,
        score_threshold: float | None = None,
        nms_iou: float | None = None,
        max_boxes: int | None = None,
        classes: Classes | None = None,
        calibrated: bool = True,
        name: str = "",
    ) -> None:
        if precision not in ("auto", *DTYPES):
            raise ConfigError(f"Expected precision to be one of 'auto', {str([*DTYPES])[1:-1]}; got {precision!r}.")
        self.device = chosen_device(device)
        self.precision, self.why_precision = precision, "asked for"
        if precision == "auto":
            self.precision, self.why_precision = default_precision(self.device, network)
        self.provenance, self.cloud, self._name = provenance or {}, cloud, name
        keep_freed_memory()
        most = None if max_boxes is None or classes is None else max(max_boxes, network.config.max_boxes)
        changes = {"score_threshold": score_threshold, "nms_iou": nms_iou, "max_boxes": most or max_boxes}
        changes = {name: value for name, value in changes.items() if value is not None}
        if not calibrated and network.config.score_bands is not None:
            changes["score_bands"] = None
        network = reconfigured(network, changes)
        self._config, bands = network.config, network.config.score_bands
        if bands is not None:  # both limits count calibrated scores
            lowest = bands.least_score(self._config.score_threshold)
            most_decoded = max(self._config.max_boxes, _BEFORE_CALIBRATION)
            network = reconfigured(network, {"score_threshold": lowest, "max_boxes": most_decoded})
        own = tuple(network.config.class_names)
        self.chosen = None if classes is None else ChosenClasses.of(classes, own, max_boxes or self._config.max_boxes)
        with fitting(_TOO_LARGE):
            network = fold_batch_norm(network)
            network.to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch lacks it
        for name in network.low_precision if self.precision != "fp32" else ():
            network.get_submodule(name).to(DTYPES[self.precision])
        if (fault := unsound(network.state_dict())) is not None:
            raise ConfigError(
                f"{self._name or network.config.name}: expected weights that are finite in {self.precision}, got "
                f"{fault[1]} of {fault[0]}: it would detect nothing. Take other weights, or precision fp32."
            )
        self.network = network

    @classmethod
    def load(cls, name: str | Path, **options: Any) -> "Detector":
        """Load a bundled detector by name, a run's folder or a weights file."""
        path = resolve_weights(name)
        network, provenance = load_weights(path)
        called = path.parent.resolve().name if path.stem == "weights" else path.stem
        return cls(network, **{"provenance": provenance, "name": called, **options})

    @property
    def config(self) -> Any:
        """The network's settings; of one whose scores are calibrated, limits are those of calibrated scores."""
        return self._config

    @config.setter
    def config(self, config: Any) -> None:
        """Refuse one."""
        del config
        raise ConfigError(FIXED)

    @property
    def name(self) -> str:
        """What it is called: its weights, or their run; without either its experiment, or its kind."""
        return self._name or str(self.provenance.get("experiment", {}).get("name", self.config.name))

    def __repr__(self) -> str:
        """Its name, kind and classes, and what it keeps."""
        config, learnt = self.config, ", ".join(self.learnt_clouds)
        named = {} if self.chosen is None else self.chosen.names
        renamed = [own if own == shown else f"{own} as {shown}" for own, shown in named.items()]
        return (
            f"Detector({self.name}: {config.name} to {self.reach_m:g} m; "
            f"classes {', '.join(renamed or self.class_names)}; "
            f"reads {', '.join(self.columns)} of a {self.kind}{f', learnt from {learnt}' if learnt else ''}; "
            f"scores from {config.score_threshold:g}, overlaps up to {config.nms_iou:g}, at most "
            f"{config.max_boxes if self.chosen is None else self.chosen.max_boxes} boxes; "
            f"{self.precision} on {self.device})"
        )

    def _repr_html_(self) -> str | None:
        """What a notebook shows: where it looks, and for what."""
        return display_html("detector", self)

    @property
    def info(self) -> DetectorInfo:
        """What is known of it: what it reads, what it gives, and what it was trained on."""
        return DetectorInfo(
            name=self.name,
            network=type(self.network).__name__,
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
        return tuple(dict.fromkeys(name for source in self.network.inputs.values() for name in source.columns))

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

    def digest(self) -> str:
        """SHA-256 of all that decides its boxes: weights, settings, precision, and the kind of its device."""
        settings = [type(self.network).__name__, self.config.model_dump(mode="json"), self.precision, self.device.type]
        settings += [] if self.chosen is None else [dict(self.chosen.names), self.chosen.max_boxes]
        digest = hashlib.sha256(json.dumps([*settings, self.cloud], sort_keys=True, default=str).encode())
        for name, values in self.network.state_dict().items():
            digest.update(f"\0{name}\0{values.dtype}\0{tuple(values.shape)}".encode())
            digest.update(values.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
        return digest.hexdigest()

    def with_cloud(self, cloud: str | Mapping[str, str] | None) -> "Detector":
        """The same detector reading another of a frame's clouds; weights are shared."""
        other = copy.copy(self)
        other.cloud = cloud
        return other

    def __call__(self, frame: Any) -> Boxes:
        """Detect objects; boxes are in the frame's coordinates, best first.

        Args:
            frame: A frame, a cloud, the path of a cloud file, an array or a table, see
                :func:`farfield.frame.door.frame_of`.

        Raises:
            ConfigError: As of :meth:`detect`, and if it is nothing of these.
        """
        return self.detect([frame if isinstance(frame, Cloud) else frame_of(frame)])[0]

    def detect(self, frames: Sequence[Frame | Cloud]) -> list[Boxes]:
        """Detect objects in a batch of frames.

        Raises:
            ConfigError: If a frame stands in other coordinates than those that the detector learnt in, or has no cloud
                of the kind and with the columns that it reads.
            OutOfMemory: If the frames do not fit into the device's memory.
        """
        # Choose the cloud of each input, and take its columns as tensors.
        clouds = [self._clouds(frame) for frame in frames]
        sources = self.network.inputs.items()
        named = {
            name: [cloud_tensor(frame_clouds[name], source.columns) for frame_clouds in clouds]
            for name, source in sources
        }
        # One forward pass of all frames; then the classes that were chosen.
        with fitting(_TOO_LARGE):
            detected = self.network.predict(Inputs(named).on(self.device))
        if self.config.score_bands is not None:
            points = [torch.cat([named[name][row][:, :3] for name in named]).numpy() for row in range(len(frames))]
            detected = [self._calibrated(boxes, cloud) for boxes, cloud in zip(detected, points, strict=True)]
        return detected if self.chosen is None else [self.chosen(boxes) for boxes in detected]

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
        inputs = self.network.inputs
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
        elif len(self.network.inputs) > 1:
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
        return ", ".join(self.network.inputs[source].columns)

    def _misfit(self, frame: Frame, name: str, source: str) -> str:
        """Why an input cannot be read from a frame's cloud; empty where it can."""
        sensor = frame.sensors.get(name)
        if sensor is not None and len(self.network.inputs) == 1 and sensor.kind != self.kind:
            return f"it is of a {sensor.kind}"
        if sensor is not None and not sensor.in_frame:
            return "it keeps its sensor's own coordinates"
        cloud = frame.cloud(name)
        present = (*cloud.columns, "lag_s", *(("intensity",) if cloud.kind == "lidar" else ()))
        missing = [column for column in self.network.inputs[source].columns if column not in present]
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


# A detector's dense trunk recorded once as a CUDA graph: one call a frame instead of one a layer.


class Graphed(nn.Module):
    """A module recorded once as a CUDA graph, and replayed for inputs of the recorded shape.

    Args:
        module: What is recorded, in evaluation mode; it computes inputs of other shapes itself.
        image: An input of it, on a GPU.
    """

    def __init__(self, module: nn.Module, image: Tensor) -> None:
        super().__init__()
        self.module = module  # the graph reads its weights
        self.image = image.clone()
        stream = torch.cuda.Stream(image.device)
        stream.wait_stream(torch.cuda.current_stream(image.device))
        with torch.no_grad(), torch.cuda.stream(stream):
            for _ in range(3):
                module(self.image)
        torch.cuda.current_stream(image.device).wait_stream(stream)
        self.graph = torch.cuda.CUDAGraph()
        with torch.no_grad(), torch.cuda.graph(self.graph):
            self.out = module(self.image)

    def forward(self, image: Tensor) -> Tensor:
        """The output for an image; the next call overwrites it."""
        if image.shape != self.image.shape or image.dtype != self.image.dtype or torch.is_grad_enabled():
            out: Tensor = self.module(image)
            return out
        self.image.copy_(image)
        self.graph.replay()
        return self.out


def record_trunk(detector: Detector, frame: Frame | Cloud) -> None:
    """Record a detector's dense trunk from a frame, in place; batches of as many frames replay it from then on.

    Args:
        detector: A PointPillars, SECOND or VoxelNet on a GPU.
        frame: Any frame that it can read.

    Raises:
        ConfigError: If the detector has no dense trunk, or is not on a GPU.
    """
    trunk = getattr(detector.network, "backbone", None)
    if detector.device.type != "cuda" or not isinstance(trunk, nn.Module):
        subject = f"{detector.name} on {detector.device}"
        raise ConfigError(f"record_trunk: expected PointPillars, SECOND or VoxelNet on a GPU; got {subject}")
    images: list[Tensor] = []
    hook = trunk.register_forward_pre_hook(lambda _, inputs: images.append(inputs[0]))
    try:
        detector(frame)
    finally:
        hook.remove()
    if not images or not torch.is_tensor(images[0]):
        raise ConfigError(f"record_trunk: expected a trunk that reads a dense map; {detector.name} has none")
    detector.network.backbone = Graphed(trunk, images[0])
