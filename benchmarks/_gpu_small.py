"""Detectors small enough for a CPU to train beside the GPU: a window of 64 m x 40 m, few channels."""

from typing import Any

from farfield.testing.detectors import built

_WINDOW = {"range_m": 64.0, "half_width_m": 20.0}
_LOW = {**_WINDOW, "z_min_m": -3.0, "z_max_m": 1.0}
_BANDS = {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]}
_RADAR = {
    "grid": {**_LOW, "voxel_m": [1.0, 1.0, 1.0]},
    "anchors": {"vehicle": {"size_m": [4.2, 2.1, 2.0], "z_m": -1.0, "positive_iou": 0.5, "negative_iou": 0.2}},
    "proposals": "anchors",
    "neck_width": 32,
}
_LEVELS = [
    {"centres": 512, "radii_m": [0.5, 1.5], "limits": [16, 32], "widths": [[16, 32], [16, 32]]},
    {"centres": 128, "radii_m": [1.5, 4.0], "limits": [16, 32], "widths": [[32, 48], [32, 48]]},
]
SETTINGS: dict[str, dict[str, Any]] = {
    "pointpillars": {
        "grid": {**_WINDOW, "cell_m": 0.5},
        "widths": [16, 32, 32],
        "neck_width": 32,
        "out_stride": 2,
    },
    "second": {
        "grid": {**_WINDOW, "voxel_m": [0.25, 0.25, 0.45]},
        "middle_widths": [8, 8, 16, 16],
        "middle_out": 32,
        "widths": [64, 64],
        "depths": [0, 0],
        "neck_width": 64,
    },
    "voxelnet": {
        "grid": {**_LOW, "voxel_m": [0.5, 0.5, 0.8]},
        "vfe_widths": [8, 16],
        "voxel_channels": 16,
        "middle_widths": [16, 16, 16],
        "widths": [16, 32, 32],
        "depths": [1, 2, 2],
        "neck_width": 32,
    },
    "pointrcnn": {
        "window": _WINDOW,
        "sizes_m": {"vehicle": [4.6, 1.95, 1.7], "pedestrian": [0.75, 0.7, 1.75]},
        "points": 2048,
        "bands": _BANDS,
        "backbone": {"levels": _LEVELS, "propagation": [[64], [64]]},
        "head_width": 64,
        "proposals": {"threshold": 0.0, "candidates": 256, "training_count": 64, "count": 48, "bands": _BANDS},
        "refinement": {"points": 64, "match": {"drawn": 48}},
    },
    "sparsecentre": {
        "grid": {**_WINDOW, "z_min_m": -4.0, "z_max_m": 4.0, "voxel_m": [0.4, 0.4, 0.5]},
        "classes": ["vehicle", "pedestrian"],
        "widths": [16, 32],
        "depths": [0, 1],
        "pyramid_widths": [32, 32, 32],
    },
    "rtn": {**_RADAR, "planes": 16, "depths": [1, 1, 1], "strides": [1, 2, 2]},
    "rtnh": {**_RADAR, "cell_channels": 16, "widths": [16, 16, 32]},
}


def small_network(name: str, seed: int) -> Any:
    """The small network of a detector, its weights drawn with a seed."""
    return built(name, SETTINGS[name], seed=seed)
