"""A small configuration of every detector: a window of 64 m x 40 m that one core trains in seconds."""

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.network import Network
from farfield.frame import Boxes, Cloud


@dataclass(frozen=True)
class Small:
    """Settings of a small network, and what it takes at most to learn one frame by heart."""

    settings: dict[str, Any]
    steps: int = 100
    learning_rate: float = 3e-3


def _level(centres: int, radii_m: tuple[float, float], *widths: tuple[int, int]) -> dict[str, Any]:
    """One level of PointNet++."""
    return {"centres": centres, "radii_m": radii_m, "limits": [16, 32], "widths": widths}


_CELLS = {
    "grid": {"range_m": 64.0, "half_width_m": 20.0, "z_min_m": -3.0, "z_max_m": 1.0, "cell_m": [1.0, 1.0, 1.0]},
    "anchors": {"vehicle": {"size_m": [4.2, 2.1, 2.0], "z_m": -1.0, "positive_iou": 0.5, "negative_iou": 0.2}},
    "proposals": "anchors",
}
_PILLARS = {"grid": {"range_m": 64.0, "half_width_m": 20.0, "cell_m": 0.5}}

SMALL: dict[str, Small] = {
    "pointpillars": Small({**_PILLARS, "widths": [16, 32, 32], "neck_width": 32, "out_stride": 2}),
    "pointrcnn": Small(
        {
            "grid": {"range_m": 64.0, "half_width_m": 20.0},
            "sizes_m": {"vehicle": [4.6, 1.95, 1.7], "pedestrian": [0.75, 0.7, 1.75]},
            "points": 2048,
            "bands": {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]},
            "backbone": {
                "levels": [
                    _level(512, (0.5, 1.5), (16, 32), (16, 32)),
                    _level(128, (1.5, 4.0), (32, 48), (32, 48)),
                ],
                "propagation": [[64], [64]],
            },
            "head_width": 64,
            "proposals": {
                "threshold": 0.0,
                "candidates": 256,
                "training_count": 64,
                "count": 48,
                "bands": {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]},
            },
            "refinement": {"points": 64, "match": {"drawn": 48}},
        },
        steps=100,
        learning_rate=4e-3,
    ),
    "rtn": Small(
        {**_CELLS, "planes": 16, "depths": [1, 1, 1], "strides": [1, 2, 2], "neck_width": 32},
        steps=100,
        learning_rate=8e-3,
    ),
    "rtnh": Small(
        {**_CELLS, "cell_channels": 16, "widths": [16, 16, 32], "neck_width": 32}, steps=100, learning_rate=6e-3
    ),
    "second": Small(
        {
            "grid": {"range_m": 64.0, "half_width_m": 20.0, "cell_m": [0.25, 0.25, 0.45]},
            "middle_widths": [8, 8, 16, 16],
            "middle_out": 32,
            "widths": [64, 64],
            "depths": [0, 0],
            "neck_width": 64,
            "matching": "iou",
        },
        learning_rate=6e-3,
    ),
    "sparsecentre": Small(
        {
            "grid": {
                "range_m": 64.0,
                "half_width_m": 20.0,
                "z_min_m": -4.0,
                "z_max_m": 4.0,
                "cell_m": [0.4, 0.4, 0.5],
            },
            "classes": ["vehicle", "pedestrian"],
            "widths": [16, 32],
            "depths": [0, 1],
            "pyramid_widths": [32, 32, 32],
        },
        steps=100,
        learning_rate=6e-3,
    ),
    "voxelnet": Small(
        {
            "grid": {
                "range_m": 64.0,
                "half_width_m": 20.0,
                "z_min_m": -3.0,
                "z_max_m": 1.0,
                "cell_m": [0.5, 0.5, 0.8],
            },
            "vfe_widths": [8, 16],
            "voxel_channels": 16,
            "middle_widths": [16, 16, 16],
            "widths": [16, 32, 32],
            "depths": [1, 2, 2],
            "neck_width": 32,
        },
        steps=100,
        learning_rate=5e-3,
    ),
}


def cloud_of(network: Network, cloud: Cloud) -> Tensor:
    """A cloud with the columns that a network reads."""
    return cloud_tensor(cloud, network.inputs["points"].columns)


def batch_of(*clouds: Tensor) -> Inputs:
    """Clouds as a network takes them."""
    return Inputs({"points": clouds})


def targets_of(network: Network, boxes: Boxes, cloud: Tensor) -> Any:
    """Targets of one frame."""
    return network.assigner(boxes, {"points": cloud.numpy()})


def losses_of(network: Network, clouds: list[Tensor], boxes: list[Boxes]) -> dict[str, Tensor]:
    """The losses of a batch by name."""
    targets = [targets_of(network, each, cloud) for each, cloud in zip(boxes, clouds, strict=True)]
    return network.losses(network(batch_of(*clouds), targets), targets)


def small_detector(name: str, *, seed: int = 3, **changes: Any) -> Any:
    """The small network of a detector, its weights drawn with a seed."""
    settings = {"name": name, **SMALL[name].settings, **changes}
    return build_detector(DETECTORS[name].config_class.model_validate(settings), seed=seed)
