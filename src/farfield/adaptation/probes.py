"""What tells whether an adaptation does what it should: gradients at the shared features, and a fresh linear probe."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from farfield.adaptation.adversarial import balanced_accuracy, logits_of
from farfield.adaptation.cells import Cells, occupied, values_at, z_range_m
from farfield.detectors.features import Features, PointFeatures
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.losses import sum_over_processes
from farfield.detectors.network import Network
from farfield.detectors.runtime import Detector
from farfield.detectors.sparse.cells import SparseTensor
from farfield.frame import Frame
from farfield.training.method import Batch, detection_losses, total_of

# The same on held-out frames

_ROWS = 2048  # features of a frame and a domain that the probe reads


@runtime_checkable
class ValidationProbe(Protocol):
    """A method that can say of any frame which cells are of which domain."""

    modules: nn.ModuleDict

    def reader(self, stream: str) -> Network:
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
    figures = {f"held_loss_{name}": sum(values) / len(values) for name, values in gathered.losses.items()}
    if gathered.logits:
        figures["held_accuracy"] = float(balanced_accuracy(torch.cat(gathered.logits), torch.cat(gathered.truth)))
    figures["probe_accuracy"] = probe_accuracy(gathered.rows.get(0, []), gathered.rows.get(1, []))
    figures["proxy_distance"] = 2 * (2 * figures["probe_accuracy"] - 1)
    return figures


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
        loss = total_of(detection_losses(network, features, frame.targets))
        gathered.losses.setdefault(stream, []).append(float(loss))
    for domain, cells in method.domains(features, frame.inputs, stream, number):
        step = max(1, -(-len(cells) // _ROWS))
        shown = cells[torch.arange(0, len(cells), step, device=cells.row.device)]
        gathered.rows.setdefault(domain, []).append(values_at(features, shown).float())
        if "discriminator" in method.modules:
            logits = logits_of(method.modules["discriminator"], features, cells, 0.0)
            gathered.logits.append(logits)
            gathered.truth.append(torch.full_like(logits, float(domain)))


_PROBE_STEPS, _PROBE_RATE, _PROBE_DECAY = 200, 0.05, 1e-3


def shared_values(features: Features) -> Tensor:
    """The tensor of features that heads and discriminators share."""
    if isinstance(features, PointFeatures):
        return features.values
    return features.values.features if isinstance(features.values, SparseTensor) else features.values


def gradient_norms(losses: Mapping[str, Tensor], features: Sequence[Features]) -> dict[str, float]:
    """Norm of each loss' gradient at the shared features, over all processes; the training's own stay as they are.

    Behind a gradient reversal the norm is lambda times that of the discriminator's gradient. A loss that does not reach
    the features has 0.

    Args:
        losses: By name.
        features: Those that the losses were computed from, of one forward or of several.

    Returns:
        ``gradient_<name>`` of each.
    """
    values = [value for part in features if (value := shared_values(part)).requires_grad]
    norms = {}
    for name, loss in losses.items():
        parts: Sequence[Tensor | None] = [None]
        if values and loss.requires_grad:
            with torch.autocast(loss.device.type, enabled=False):
                parts = torch.autograd.grad(loss, values, retain_graph=True, allow_unused=True)
        squares = sum(float(part.detach().float().square().sum()) for part in parts if part is not None)
        shared = sum_over_processes(torch.tensor(squares, dtype=torch.float64, device=loss.device))
        norms[f"gradient_{name}"] = math.sqrt(float(shared))
    return norms


def gradient_ratio(norms: Mapping[str, float], detection: str = "detection") -> float:
    """How hard the hardest other loss pulls over the detection's; NaN where that does not pull.

    Args:
        norms: What :func:`gradient_norms` gave.
        detection: Name of the detection's loss.
    """
    own = norms[f"gradient_{detection}"]
    others = [value for name, value in norms.items() if name != f"gradient_{detection}"]
    return max(others, default=math.nan) / own if own > 0 else math.nan


def probe_accuracy(one: Sequence[Tensor], other: Sequence[Tensor]) -> float:
    """Balanced accuracy of a fresh linear probe that tells two domains by their features.

    It learns on every second frame of each domain and is scored on the rest: logistic regression on standardised
    features, 200 full steps of Adam. A discriminator at 0.5 may be weak; where this too is at 0.5, a linear view tells
    nothing. ``2 (1 - 2 (1 - accuracy))`` is the proxy A-distance (Ben-David et al. 2010).

    Args:
        one: Features of each frame of a domain, shapes (n, c).
        other: Those of the other one.

    Returns:
        From 0 to 1; NaN with fewer than two frames with features in a domain.
    """
    domains = [[rows.detach().float() for rows in frames if len(rows)] for frames in (one, other)]
    if min(map(len, domains)) < 2:
        return math.nan
    train, test = ([torch.cat(frames[part::2]) for frames in domains] for part in (0, 1))
    mean = torch.cat(train).mean(0)
    scale = torch.cat(train).std(0).clamp(min=1e-6)
    train, test = ([(rows - mean) / scale for rows in domain] for domain in (train, test))
    weight, bias = fitted_probe(train[0], train[1])
    with torch.no_grad():
        answers = [rows @ weight + bias > 0 for rows in test]
        shares = [float((answer == bool(domain)).float().mean()) for domain, answer in enumerate(answers)]
    return sum(shares) / 2


@torch.enable_grad()
def fitted_probe(one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """Weight (c,) and bias of a logistic regression whose logit is positive for ``other``; both domains weigh alike."""
    weight = torch.zeros(one.shape[1], device=one.device, requires_grad=True)
    bias = torch.zeros((), device=one.device, requires_grad=True)
    optimiser = torch.optim.Adam([weight, bias], lr=_PROBE_RATE)
    for _ in range(_PROBE_STEPS):
        optimiser.zero_grad()
        wrong = [functional.softplus(sign * (rows @ weight + bias)).mean() for sign, rows in ((1, one), (-1, other))]
        (wrong[0] + wrong[1] + _PROBE_DECAY * weight.square().sum()).backward()
        optimiser.step()
    return weight.detach(), bias.detach()


# Features of a trained detector's frames, to be looked at or compared


@dataclass(frozen=True, eq=False, kw_only=True)
class OccupiedFeatures:
    """Features of occupied cells.

    Args:
        values: The features, shape (n, c).
        range_m: Distance of each cell's centre in the plane, shape (n,).
        frame: Number of the frame of each, shape (n,).
    """

    values: Float[np.ndarray, "n c"]
    range_m: Float[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]


@torch.no_grad()
def occupied_features(
    detector: Detector, frames: Sequence[Frame], cloud: str, *, limit: int = 1000, seed: int = 0
) -> OccupiedFeatures:
    """The features that enter a detector's head, at cells that hold points.

    Args:
        detector: The detector; it has one input.
        frames: The frames.
        cloud: Which of their clouds to read.
        limit: Cells a frame at most, drawn at random.
        seed: Seed of the draw.
    """
    ((name, source),) = detector.network.inputs.items()
    rng, features_by_frame = np.random.default_rng(seed), list[tuple[np.ndarray, np.ndarray]]()
    for frame in frames:
        points = cloud_tensor(frame.cloud(cloud), source.columns)
        inputs = Inputs({name: [points]}).to(detector.device)
        features = detector.network.encode(inputs)
        cells = occupied(features, inputs, z_range_m(detector.config))
        chosen = torch.from_numpy(np.sort(rng.permutation(len(cells))[:limit])).to(cells.row.device)
        values = values_at(features, cells[chosen]).float().cpu().numpy().astype(np.float64)
        features_by_frame.append((values, cells[chosen].place_m.float().norm(dim=1).cpu().numpy().astype(np.float64)))
    return OccupiedFeatures(
        values=np.concatenate([values for values, _ in features_by_frame]),
        range_m=np.concatenate([range_m for _, range_m in features_by_frame]),
        frame=np.repeat(np.arange(len(features_by_frame)), [len(values) for values, _ in features_by_frame]),
    )
