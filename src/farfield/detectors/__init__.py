"""Frames to scored boxes. One paper is one file.

``DETECTORS`` names every detector; its module is imported when it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    from torch import nn

DETECTORS = {"pointpillars": ("farfield.detectors.pointpillars", "PointPillars", "PointPillarsConfig")}


def detector_classes(name: str) -> tuple[type, type]:
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


def build_detector(config: Any) -> "nn.Module":
    """Build the untrained network that a configuration object describes."""
    return detector_classes(config.name)[0](config)
