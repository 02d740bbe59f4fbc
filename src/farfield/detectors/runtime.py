"""Running a trained network on frames: which boxes it gives, precision, folding, memory, and which clouds it reads."""

import ctypes
import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError
from torch import Tensor, nn

from farfield.detectors.devices import DTYPES, chosen_device, default_precision, fitting
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.layers import fold_batch_norm
from farfield.detectors.network import FIXED, Network, build_detector
from farfield.detectors.soundness import unsound
from farfield.detectors.trained import ChosenClasses, Classes, TrainedDetector
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.errors import ConfigError, plain
from farfield.frame import Cloud, Frame
from farfield.geometry.boxes import Boxes


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


class Detector(TrainedDetector):
    """A trained network that turns frames into boxes.

    Args:
        network: The network; a folded copy in evaluation mode is kept.
        provenance: What is known of its training.
        device: Where to run; by default, and for ``"auto"``, a GPU if there is one, else the CPU.
        precision: ``"fp32"``, ``"bf16"``, ``"fp16"`` or ``"auto"``: bf16 where the device has
            instructions for it, else fp32; ``why_precision`` says why.
        cloud: Which of a frame's clouds to read, for a network of several inputs one for each; by default one that it
            learnt from, where a frame has none of them its first that fits.
        score_threshold: Boxes below are not given (default: this and the following are the weights' own).
        nms_iou: Boxes that overlap a better one by more are not given.
        max_boxes: Boxes given in a frame.
        classes: Classes to give, or for each of them the name to give it (default: all). Boxes of the others still
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
    def read_columns(self) -> Mapping[str, Sequence[str]]:
        """Columns of each cloud that it reads, by the name of the network's input."""
        return {name: source.columns for name, source in self.network.inputs.items()}

    @property
    def network_name(self) -> str:
        """Class of its network, such as ``"PointPillars"``."""
        return type(self.network).__name__

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

    def digest(self) -> str:
        """SHA-256 of all that decides its boxes: weights, settings, precision, and the kind of its device."""
        settings = [type(self.network).__name__, self.config.model_dump(mode="json"), self.precision, self.device.type]
        settings += [] if self.chosen is None else [dict(self.chosen.names), self.chosen.max_boxes]
        digest = hashlib.sha256(json.dumps([*settings, self.cloud], sort_keys=True, default=str).encode())
        for name, values in self.network.state_dict().items():
            digest.update(f"\0{name}\0{values.dtype}\0{tuple(values.shape)}".encode())
            digest.update(values.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
        return digest.hexdigest()

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
