"""A small configuration of every detector: a window of 64 m x 40 m that one core trains in seconds."""

from dataclasses import dataclass, field
from typing import Any

from farfield.detectors import build_detector, detector_classes


@dataclass(frozen=True)
class Small:
    """Settings of a small network, and what it takes to learn one frame by heart."""

    settings: dict[str, Any]
    steps: int = 90
    learning_rate: float = 3e-3
    cut: tuple[str, ...] = field(default=())


_PILLARS = {"grid": {"range_m": 64.0, "half_width_m": 20.0, "cell_m": 0.5}}

SMALL: dict[str, Small] = {
    "pointpillars": Small({**_PILLARS, "widths": [16, 32, 32], "neck_width": 32, "out_stride": 2}),
    "second": Small(
        {
            "grid": {"range_m": 64.0, "half_width_m": 20.0, "voxel_m": [0.25, 0.25, 0.45]},
            "middle_widths": [8, 8, 16, 16],
            "middle_out": 32,
            "widths": [64, 64],
            "depths": [0, 0],
            "neck_width": 64,
            "positive_m": 2.0,
        },
        learning_rate=5e-3,
    ),
    "sparsecentre": Small(
        {
            "grid": {
                "range_m": 64.0,
                "half_width_m": 20.0,
                "z_min_m": -4.0,
                "z_max_m": 4.0,
                "voxel_m": [0.4, 0.4, 0.5],
            },
            "classes": ["vehicle", "pedestrian"],
            "widths": [16, 32],
            "depths": [0, 1],
            "pyramid_widths": [32, 32, 32],
        },
        steps=60,
        learning_rate=4e-3,
    ),
    "voxelnet": Small(
        {
            "grid": {
                "range_m": 64.0,
                "half_width_m": 20.0,
                "z_min_m": -3.0,
                "z_max_m": 1.0,
                "voxel_m": [0.5, 0.5, 0.8],
            },
            "vfe_widths": [8, 16],
            "voxel_channels": 16,
            "middle_widths": [16, 16, 16],
            "widths": [16, 32, 32],
            "depths": [1, 2, 2],
            "neck_width": 32,
        },
        steps=80,
    ),
}


def small_detector(name: str, *, seed: int = 3, **changes: Any) -> Any:
    """The small network of a detector, its weights drawn with a seed."""
    settings = {"name": name, **SMALL[name].settings, **changes}
    return build_detector(detector_classes(name)[1].model_validate(settings), seed=seed)
