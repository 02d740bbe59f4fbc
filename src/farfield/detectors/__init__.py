"""Frames to scored boxes. One paper is one folder; what several share is named by what it is.

``DETECTORS`` names every detector; what it needs is imported when it is asked for.
"""

from typing import TYPE_CHECKING

from farfield.detectors.kinds import DETECTORS, DetectorSpec, detector

if TYPE_CHECKING:
    from farfield.detectors.contract import DetectorConfig, Network

__all__ = ["DETECTORS", "DetectorSpec", "build_detector", "detector"]


def build_detector(config: "DetectorConfig", *, seed: int | None = None) -> "Network":
    """Build the untrained network that a configuration describes; a seed makes its weights repeatable.

    Raises:
        ConfigError: If there is no detector of the configuration's name.
        MissingExtraError: If torch is not installed.
    """
    network = DETECTORS[config.name].network_class
    if seed is not None:
        import torch

        torch.manual_seed(seed)
    return network(config)
