"""Frames to scored boxes. One paper is one folder; what several share is named by what it is.

``DETECTORS`` names every detector. Everything that a writer of a detector needs is offered here; what needs torch is
imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from farfield.detectors.spec import DETECTORS, DetectorSpec, detector
from farfield.errors import MissingExtraError
from farfield.registry import old_names

if TYPE_CHECKING:
    from farfield.detectors.anchors.grid import AnchorConfig, AnchorGrid
    from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
    from farfield.detectors.config import Channels, DetectorConfig, GridConfig, VoxelGridConfig
    from farfield.detectors.features import FeatureMap, PointFeatures, in_type_of
    from farfield.detectors.info import DetectorInfo, FunctionDetector, describe
    from farfield.detectors.inputs import POSITION, CloudInput, Inputs, stacked
    from farfield.detectors.losses import normaliser, sum_over_processes
    from farfield.detectors.network import Assigner, MapDetector, Network, build_detector
    from farfield.detectors.runtime import Detector
    from farfield.detectors.weights import load_weights, save_weights

_LAZY = {
    "farfield.detectors.anchors.grid": ("AnchorConfig", "AnchorGrid"),
    "farfield.detectors.anchors.head": ("AnchorHead", "AnchorHeadConfig"),
    "farfield.detectors.config": ("Channels", "DetectorConfig", "GridConfig", "VoxelGridConfig"),
    "farfield.detectors.features": ("FeatureMap", "PointFeatures", "in_type_of"),
    "farfield.detectors.info": ("DetectorInfo", "FunctionDetector", "describe"),
    "farfield.detectors.inputs": ("POSITION", "CloudInput", "Inputs", "stacked"),
    "farfield.detectors.losses": ("normaliser", "sum_over_processes"),
    "farfield.detectors.network": ("Assigner", "MapDetector", "Network", "build_detector"),
    "farfield.detectors.runtime": ("Detector",),
    "farfield.detectors.weights": ("load_weights", "save_weights"),
}
_old_name = old_names(__name__, Kind="DetectorSpec")
_MODULES = {name: module for module, names in _LAZY.items() for name in names}

__all__ = [
    "DETECTORS",
    "POSITION",
    "AnchorConfig",
    "AnchorGrid",
    "AnchorHead",
    "AnchorHeadConfig",
    "Assigner",
    "Channels",
    "CloudInput",
    "Detector",
    "DetectorConfig",
    "DetectorInfo",
    "DetectorSpec",
    "FeatureMap",
    "FunctionDetector",
    "GridConfig",
    "Inputs",
    "MapDetector",
    "Network",
    "PointFeatures",
    "VoxelGridConfig",
    "build_detector",
    "describe",
    "detector",
    "in_type_of",
    "load_weights",
    "normaliser",
    "save_weights",
    "stacked",
    "sum_over_processes",
]


def __getattr__(name: str) -> Any:
    """Import a name on first use.

    Raises:
        MissingExtraError: If torch is not installed and the name needs it.
    """
    if name not in _MODULES:
        return _old_name(name)
    try:
        return getattr(import_module(_MODULES[name]), name)
    except ModuleNotFoundError as error:
        if error.name == "torch":
            raise MissingExtraError("torch", "detect", "Detecting objects") from error
        raise


def __dir__() -> list[str]:
    """The public names."""
    return list(__all__)
