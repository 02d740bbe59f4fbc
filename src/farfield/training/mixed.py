"""Supervised training on several data sets at once, so that one detector learns from many sensors."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field
from torch import Tensor, nn

from farfield.detectors.network import Network
from farfield.training.method import (
    DETECTOR,
    Batch,
    Method,
    MethodSettings,
    Stream,
    detection_losses,
    network_of,
    settings_of,
)


class MixedSettings(MethodSettings):
    """Settings of the method ``mixed``."""

    shares: dict[str, float] = Field(min_length=1, description="part of each batch by the name of its data")


class MixedSupervision(Method):
    """Train a detector on annotated frames of several data sets: one forward pass, and one set of statistics, a step.

    Args:
        network: The detector's network.
        **settings: Fields of :class:`MixedSettings`; ``data`` has a group for each name in ``shares``.
    """

    def __init__(self, network: Network, **settings: Any) -> None:
        shares = settings_of(MixedSettings, "mixed", settings).shares
        self.streams: Mapping[str, Stream] = {name: Stream(share=share) for name, share in shares.items()}  # type: ignore[misc]
        self.modules = nn.ModuleDict({DETECTOR: network})

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The network's own losses of all frames."""
        del step
        parts = [batch[name] for name in self.streams]
        inputs, targets = parts[0].inputs, list[Any](parts[0].targets)
        for part in parts[1:]:
            inputs = inputs + part.inputs
            targets += part.targets
        network = network_of(self.modules)
        return detection_losses(network, network.encode(inputs), targets)


def family_of(streams: Mapping[str, Mapping[str, Any]]) -> str:
    """What weights learnt from, in the words by which families of weights are told apart.

    Args:
        streams: The provenance's ``streams``: those with ``simulated`` true are simulated, ``donors`` says which sweeps
            lent their background.
    """
    donors = {str(stream["donors"].get("family")) for stream in streams.values() if stream.get("donors")}
    sources: Sequence[bool] = [bool(stream.get("simulated")) for stream in streams.values() if not stream.get("donors")]
    base = "simulation" if all(sources) else "real sweeps"
    if "own" in donors:
        return f"{base} with a user's sweeps"
    return f"{base} with open donors" if donors else base
