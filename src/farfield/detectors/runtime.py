"""Running a trained network on frames: precision, folding, memory, and which points to feed."""

import copy
import ctypes
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from farfield.detectors.folding import fold_batch_norm
from farfield.detectors.weights import default_precision, load_weights, resolve_weights
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame
from farfield.geometry.boxes import Boxes


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


class Detector:
    """A trained network that turns frames into boxes.

    Args:
        network: The network; a folded copy in evaluation mode is kept.
        provenance: What is known of its training.
        device: Where to run; by default a GPU if there is one, else the CPU.
        precision: ``"fp32"``, ``"bf16"`` or ``"auto"``.
        cloud: Which of a frame's clouds to read; by default one that it learnt from, where a frame has none of them
            its first.

    Raises:
        ConfigError: If the precision is unknown.
    """

    def __init__(
        self,
        network: nn.Module,
        *,
        provenance: dict[str, Any] | None = None,
        device: str | torch.device | None = None,
        precision: str = "auto",
        cloud: str | None = None,
    ) -> None:
        if precision not in ("auto", "fp32", "bf16"):
            raise ConfigError(f"Expected precision to be one of 'auto', 'fp32', 'bf16'; got {precision!r}.")
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.precision = default_precision(self.device) if precision == "auto" else precision
        self.provenance, self.cloud, self.config = provenance or {}, cloud, network.config
        keep_freed_memory()
        network = fold_batch_norm(network).to(self.device, memory_format=torch.channels_last)
        if self.precision == "bf16":
            for name in network.low_precision:
                network.get_submodule(name).bfloat16()
        self.network = network

    @classmethod
    def load(cls, name: str | Path, **options: Any) -> "Detector":
        """Load a bundled detector by name, a run's folder or a weights file."""
        network, provenance = load_weights(resolve_weights(name))
        return cls(network, provenance=provenance, **options)

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes that this detector tells apart."""
        return tuple(self.config.class_names)

    def with_cloud(self, cloud: str | None) -> "Detector":
        """The same detector reading another of a frame's clouds; weights are shared."""
        other = copy.copy(self)
        other.cloud = cloud
        return other

    def __call__(self, frame: Frame | Cloud) -> Boxes:
        """Detect objects; boxes are in the frame's coordinates, best first."""
        return self.detect([frame])[0]

    def detect(self, frames: Sequence[Frame | Cloud]) -> list[Boxes]:
        """Detect objects in a batch of frames."""
        clouds = [frame if isinstance(frame, Cloud) else frame.cloud(self._chosen(frame)) for frame in frames]
        boxes: list[Boxes] = self.network.predict(
            [cloud_tensor(cloud, self.config.extra_columns).to(self.device) for cloud in clouds]
        )
        return boxes

    def _chosen(self, frame: Frame) -> str | None:
        """The cloud that was asked for, or the first of those learnt from that the frame has, or none in particular."""
        learnt = self.provenance.get("experiment", {}).get("data", {}).get("clouds", ())
        return self.cloud or next((name for name in learnt if name in frame.clouds), None)


def cloud_tensor(cloud: Cloud, extra_columns: Sequence[str] = ()) -> Tensor:
    """A cloud as the tensor that networks read: x, y, z (metres), strength, lag (seconds), shape (n, 5 + k), float32.

    The strength is a LiDAR's intensity or, of clouds without one, a radar's column ``power``. The lag is the age of a
    point's sweep: the cloud's column ``lag_s``, or zero. Points that are not finite are dropped.

    Args:
        cloud: The cloud.
        extra_columns: Further columns of the cloud, by name; a value that is not finite counts as 0.

    Raises:
        ConfigError: If the cloud lacks one of these columns.
    """
    missing = [name for name in extra_columns if name not in cloud.extra]
    if missing:
        raise ConfigError(
            f"Expected a cloud with the column {missing[0]!r}, which the detector reads; "
            f"got {', '.join(cloud.extra) or 'no extra columns'}. Take a detector without it, or data that has it."
        )
    lag_s = cloud.extra["lag_s"] if "lag_s" in cloud.extra else np.zeros(len(cloud))
    rows = np.column_stack([cloud.points_m, _strength(cloud), lag_s]).astype(np.float32, copy=False)
    kept = np.isfinite(rows).all(axis=1)
    if extra_columns:
        extra = np.column_stack([cloud.extra[name] for name in extra_columns]).astype(np.float32, copy=False)
        rows = np.concatenate([rows, np.where(np.isfinite(extra), extra, np.float32(0.0))], axis=1)
    return torch.from_numpy(rows[kept])


def _strength(cloud: Cloud) -> np.ndarray:
    if cloud.intensity is not None:
        return cloud.intensity
    if "power" in cloud.extra:
        return cloud.extra["power"]
    raise ConfigError(
        f"Expected a cloud with intensity or with the column 'power'; got {', '.join(cloud.columns)}. Take data that "
        "have one of them."
    )
