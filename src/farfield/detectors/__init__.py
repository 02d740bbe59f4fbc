"""Frames to scored boxes. One paper is one file.

``DETECTORS`` names every detector; its module is imported when it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    from torch import nn

DETECTORS = {
    "pointpillars": ("farfield.detectors.pointpillars.network", "PointPillars", "PointPillarsConfig"),
    "pointrcnn": ("farfield.detectors.pointrcnn.network", "PointRCNN", "PointRCNNConfig"),
    "rtn": ("farfield.detectors.kradar.rtn", "RTN", "RTNConfig"),
    "rtnh": ("farfield.detectors.kradar.rtnh", "RTNH", "RTNHConfig"),
    "second": ("farfield.detectors.second", "Second", "SecondConfig"),
    "sparsecentre": ("farfield.detectors.sparsecentre.network", "SparseCentre", "SparseCentreConfig"),
    "voxelnet": ("farfield.detectors.voxelnet.network", "VoxelNet", "VoxelNetConfig"),
}
"""Name: module, network, configuration."""


def detector_classes(name: str) -> tuple[Any, Any]:
    """Return the network class and its configuration class.

    Raises:
        ConfigError: If there is no detector of this name.
        MissingExtraError: If torch is not installed.
    """
    if name not in DETECTORS:
        raise ConfigError(f"Expected a detector, one of {', '.join(DETECTORS)}; got {name!r}.")
    module_name, network, config = DETECTORS[name]
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name == "torch":
            raise MissingExtraError("torch", "detect", "Detecting objects") from error
        raise
    return getattr(module, network), getattr(module, config)


def build_detector(config: Any, *, seed: int | None = None) -> "nn.Module":
    """Build the untrained network that a configuration object describes; a seed makes its weights repeatable."""
    network = detector_classes(config.name)[0]
    if seed is not None:
        import torch

        torch.manual_seed(seed)
    return network(config)
