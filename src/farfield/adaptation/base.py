"""What all methods of adaptation share: checked settings, a share of the training that is done, a start, figures."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, distributed

from farfield.adaptation.cells import Cells, occupied, z_range_m
from farfield.adaptation.probes import gradient_norms, gradient_ratio, held_figures
from farfield.detectors.features import Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.losses import process_count, sum_over_processes
from farfield.detectors.network import Network
from farfield.errors import ConfigError
from farfield.training.method import Batch, Method, network_of, total_of

HELD_OUT: Any = Field(
    0,
    ge=0,
    description="frames of each stream that are not trained on: each tenth of the run compares the domains there",
)
"""The setting of that name, which every method has."""
_DRAWS = 5  # key of the generators, after those of the samples and the loop
_MEASURED = 50  # times in a training that gradients are measured


class Adaptation(Method):
    """A method that knows how far its training is, draws by seed and step, and keeps figures for the log."""

    def __init__(self) -> None:
        self.steps, self.seed = 0, 0
        self.noted: dict[str, Tensor | float] = {}

    def on_train_start(self, steps: int, seed: int) -> None:
        """Learn how long the training is and how its draws are seeded."""
        self.steps, self.seed = steps, seed

    def progress(self, step: int) -> float:
        """Share of the training that is done before a step.

        Raises:
            ConfigError: If the training has not said how long it is.
        """
        if self.steps < 1:
            raise ConfigError("Expected on_train_start(steps, seed) before the first step; got no number of steps.")
        return step / self.steps

    def generator(self, step: int, *, shared: bool = False) -> np.random.Generator:
        """The generator of a step: of this process, or one that all processes share."""
        rank = distributed.get_rank() if process_count() > 1 else 0
        key = (_DRAWS, step) if shared else (_DRAWS, step, rank)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    @property
    def network(self) -> Network:
        """The detector's network, which is exported."""
        return network_of(self.modules)

    def reader(self, stream: str) -> Network:
        """The network that reads a stream's held-out frames."""
        del stream
        return self.network

    def occupied(self, features: Features, inputs: Inputs) -> Cells:
        """The cells of frames that hold points within the heights that the detector looks at."""
        return occupied(features, inputs, z_range_m(self.network.config))

    def domains(self, features: Features, inputs: Inputs, stream: str, number: int) -> list[tuple[int, Cells]]:
        """Cells of a held-out frame that count, and their domain, 0 or 1; none unless a method says which.

        Args:
            features: Of one frame.
            inputs: The frame.
            stream: Its stream.
            number: Its number in the stream.
        """
        del features, inputs, stream, number
        return []

    def inspect(self, batch: Mapping[str, Batch]) -> Mapping[str, float]:
        """The discriminator's accuracy on held-out frames, a fresh probe's, and the detection's loss."""
        return {name: value for name, value in held_figures(self, batch).items() if math.isfinite(value)}

    def measures(self, step: int) -> bool:
        """Whether gradients are measured at a step: about fifty times in a training, at the first and the last too."""
        return step % max(1, self.steps // _MEASURED) == 0 or step == self.steps - 1

    def note_gradients(
        self, losses: Mapping[str, Tensor], features: Sequence[Features], step: int, *, added: Collection[str]
    ) -> None:
        """Keep the norms of the losses' gradients at the shared features, now and then; they stay until the next time.

        Args:
            losses: All of the step's losses.
            features: What they were computed from.
            step: Number of the step.
            added: Losses of the method; the sum of the others is the detection's.
        """
        if not self.measures(step):
            return
        own = {name: loss for name, loss in losses.items() if name not in added}
        norms = gradient_norms(
            {"detection": total_of(own), **{name: loss for name, loss in losses.items() if name in added}}, features
        )
        self.note(**norms, gradient_ratio=gradient_ratio(norms))

    def note(self, **values: Tensor | float) -> None:
        """Keep figures of this step for the log."""
        self.noted |= {name: value.detach() if isinstance(value, Tensor) else value for name, value in values.items()}

    def figures(self) -> Mapping[str, float]:
        """The figures of the last step, and the spread of the features that it kept by domain."""
        figures: dict[str, float] = {}
        for name, value in self.noted.items():
            if isinstance(value, Tensor) and value.ndim == 2:
                figures |= {f"variance_{name}": mean_variance(value), f"rank_{name}": effective_rank(value)}
            elif math.isfinite(float(value)):  # JSON has no NaN: what could not be measured is left out
                figures[name] = float(value)
        return figures


def weighted_losses(losses: Mapping[str, Tensor], prefix: str, weight: float) -> dict[str, Tensor]:
    """Losses times a weight, their names behind a prefix."""
    return {f"{prefix}_{name}": weight * loss for name, loss in losses.items()}


@torch.no_grad()
def common_variance(rows: Tensor) -> Tensor:
    """Mean over the channels of the variance over the rows of all processes, shape (n, c), a scalar, at least 1e-6."""
    rows = rows.float()
    count = sum_over_processes(rows.new_tensor(float(len(rows)))).clamp(min=1)
    mean = sum_over_processes(rows.sum(0)) / count
    return (sum_over_processes((rows - mean).square().sum(0)) / count).mean().clamp(min=1e-6)


def mean_variance(rows: Tensor) -> float:
    """Mean over the channels of the variance over the rows, shape (n, c); 0 for fewer than two rows."""
    return float(rows.float().var(0).mean()) if len(rows) > 1 else 0.0


def effective_rank(rows: Tensor) -> float:
    """Exp of the entropy of the squared singular values' shares, of centred rows, shape (n, c).

    1 for features that vary along one direction only (collapse), c for those that vary alike along all; 0 for none.
    """
    if len(rows) < 2:
        return 0.0
    centred = rows.float() - rows.float().mean(0)
    power = torch.linalg.svdvals(centred).double().square()
    share = power / power.sum().clamp(min=1e-30)
    return float(torch.special.entr(share).sum().exp()) if bool(power.sum() > 0) else 0.0
