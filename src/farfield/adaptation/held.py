"""Figures on frames that are not trained on: the discriminator's accuracy, a fresh probe, the detection's loss."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from farfield.adaptation.cells import Cells, values_at
from farfield.adaptation.discriminators import balanced_accuracy, logits_of
from farfield.adaptation.measuring import probe_accuracy, total
from farfield.detectors.features import Features
from farfield.detectors.inputs import Inputs
from farfield.training.method import Batch

_ROWS = 2048  # features of a frame and a domain that the probe reads


@runtime_checkable
class ValidationProbe(Protocol):
    """A method whose domains can be told apart on any frames."""

    modules: nn.ModuleDict

    def reader(self, stream: str) -> nn.Module:
        """The network that reads a stream's frames."""

    def domains(self, features: Features, inputs: Inputs, stream: str, number: int) -> list[tuple[int, Cells]]:
        """The cells of a frame that count, and their domain, 0 or 1.

        Args:
            features: Of one frame.
            inputs: The frame.
            stream: Its stream.
            number: Its number in the stream.
        """


@dataclass
class ProbeFeatures:
    """Features and the discriminator's answers, frame by frame."""

    rows: dict[int, list[Tensor]] = field(default_factory=dict)
    logits: list[Tensor] = field(default_factory=list)
    truth: list[Tensor] = field(default_factory=list)
    losses: dict[str, list[float]] = field(default_factory=dict)


@torch.no_grad()
def held_figures(method: ValidationProbe, batch: Mapping[str, Batch]) -> dict[str, float]:
    """Look at held-out frames as at inference; nothing of the training changes.

    Args:
        method: Whose domains and networks.
        batch: Held-out frames of each stream.

    Returns:
        ``held_accuracy`` of the discriminator, balanced, over occupied cells; ``probe_accuracy`` of a fresh linear
        probe and ``proxy_distance``; ``held_loss_<stream>`` of labelled streams. What cannot be measured is NaN.
    """
    gathered = ProbeFeatures()
    training = {name: module.training for name, module in method.modules.items()}
    method.modules.eval()
    try:
        for stream, number, frame in _frames(batch):
            _look(method, gathered, stream, number, frame)
    finally:
        for name, was in training.items():
            method.modules[name].train(was)
    found = {f"held_loss_{name}": sum(values) / len(values) for name, values in gathered.losses.items()}
    if gathered.logits:
        found["held_accuracy"] = float(balanced_accuracy(torch.cat(gathered.logits), torch.cat(gathered.truth)))
    found["probe_accuracy"] = probe_accuracy(gathered.rows.get(0, []), gathered.rows.get(1, []))
    found["proxy_distance"] = 2 * (2 * found["probe_accuracy"] - 1)
    return found


def _frames(batch: Mapping[str, Batch]) -> Iterator[tuple[str, int, Batch]]:
    """The frames of all streams, each as a batch of its own."""
    for name, frames in batch.items():
        for number in range(len(frames)):
            inputs = Inputs({source: [clouds[number]] for source, clouds in frames.inputs.items()})
            yield name, number, Batch(inputs, frames.targets[number : number + 1], frames.boxes[number : number + 1])


def _look(method: ValidationProbe, gathered: ProbeFeatures, stream: str, number: int, frame: Batch) -> None:
    network = method.reader(stream)
    features = network.encode(frame.inputs)
    if frame.targets:
        outputs = network.head(features, frame.targets)
        with torch.autocast(next(network.parameters()).device.type, enabled=False):
            loss = total(network.losses(outputs, frame.targets).values())
        gathered.losses.setdefault(stream, []).append(float(loss))
    for domain, cells in method.domains(features, frame.inputs, stream, number):
        step = max(1, -(-len(cells) // _ROWS))
        shown = cells[torch.arange(0, len(cells), step, device=cells.row.device)]
        gathered.rows.setdefault(domain, []).append(values_at(features, shown).float())
        if "discriminator" in method.modules:
            logits = logits_of(method.modules["discriminator"], features, cells, 0.0)
            gathered.logits.append(logits)
            gathered.truth.append(torch.full_like(logits, float(domain)))
