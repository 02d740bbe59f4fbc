"""Adaptation between two scan patterns of one road (Cirrus, section V.B, Table VI).

Both clouds of a frame are labelled and share all of the network. Paired ("joint training"): the features of two
simultaneous clouds are drawn together where both hold points. Unpaired ("adaptations"): the pairs are broken, and a
discriminator tells the patterns while its gradient reaches the trunk reversed. Neither loss, with pairs or without, is
the control that the paper leaves out: both have twice the data of one pattern, and batches of another composition.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from farfield.adaptation.adversarial import Adversarial, AdversarialLoss, discriminator, schedule
from farfield.adaptation.base import HELD_OUT, Adaptation, common_variance
from farfield.adaptation.cells import Cells, inside, shown, values_at
from farfield.adaptation.networks import start_from
from farfield.detectors.features import Features, PointFeatures
from farfield.detectors.inputs import Inputs
from farfield.detectors.losses import normaliser
from farfield.detectors.network import Network
from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.training.method import (
    DETECTOR,
    LABELLED,
    Batch,
    MethodSettings,
    ParamGroup,
    Stream,
    detection_losses,
    settings_of,
)


class PairLoss(MethodSettings):
    """The distance between the features of a pair; the paper's idea, our form and weight."""

    weight: float = Field(0.1, ge=0)
    form: Literal["scale_free", "cosine", "plain"] = Field(
        "scale_free", description="plain is smallest where features are small: it shrinks them"
    )
    max_speed_m_s: float = Field(5.0, gt=0, description="cells of boxes known to be faster are left out")


class PatternSettings(MethodSettings):
    """Which loss, and how the batches are made."""

    loss: Literal["paired", "unpaired", "none"] = "unpaired"
    batches: Literal["paired", "shuffled"] | None = Field(
        None, description="both clouds of a frame side by side, or of different frames; by default as the loss needs"
    )
    paired: PairLoss = PairLoss()
    unpaired: Adversarial = Adversarial()
    start: str | None = Field(None, description="weights to start from")
    held_out: int = HELD_OUT

    @model_validator(mode="after")
    def _possible(self) -> "PatternSettings":
        if self.loss == "paired" and self.batches == "shuffled":
            raise ValueError("expected batches: paired with loss: paired; shuffled ones hold no pairs")
        return self

    @property
    def with_pairs(self) -> bool:
        """Whether a batch holds both clouds of each of its frames."""
        return self.loss == "paired" if self.batches is None else self.batches == "paired"


class PatternAdaptation(Adaptation):
    """Learn from two clouds of each frame; the batch holds them in turn, as many of each.

    Args:
        network: The detector's network.
        **settings: See :class:`PatternSettings`.

    Raises:
        ConfigError: If a setting is unknown or does not fit.
    """

    def __init__(self, network: Network, **settings: object) -> None:
        super().__init__()
        self.settings = settings_of(PatternSettings, "pattern", settings)
        self.held_out = self.settings.held_out
        members: Literal["paired", "apart"] = "paired" if self.settings.with_pairs else "apart"
        self.streams = {LABELLED: Stream(members=members, boxes=True)}  # type: ignore[misc]
        if self.settings.start is not None:
            start_from(network, self.settings.start, "pattern")
        self.modules = nn.ModuleDict({DETECTOR: network})
        if self.settings.loss == "unpaired":
            self.modules["discriminator"] = discriminator(network, self.settings.unpaired.form)

    def param_groups(self) -> Mapping[str, ParamGroup]:
        """The discriminator learns at its own rate."""
        return self.settings.unpaired.param_groups if self.settings.loss == "unpaired" else {}

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The network's own losses over both patterns, and the one that is chosen."""
        network, frames = self.network, batch[LABELLED]
        if len(frames) % 2:
            raise ConfigError(
                f"method pattern: expected two clouds of each frame, such as clouds: [gaussian, uniform], and so an "
                f"even batch; got {len(frames)}."
            )
        features = network.encode(frames.inputs)
        losses = detection_losses(network, features, frames.targets)
        cells = self.occupied(features, frames.inputs)
        first = cells.frame % 2 == 0
        self.note(first=shown(features, cells[first]), second=shown(features, cells[~first]))
        now = schedule(self.progress(step))
        if self.settings.loss == "paired":
            losses["paired"] = self._paired(features, cells, frames.boxes, now)
        if self.settings.loss == "unpaired":
            adversary = AdversarialLoss(self.settings.unpaired, self.modules["discriminator"])
            rng = self.generator(step)
            losses["unpaired"] = adversary(features, cells, (~first).float(), now, rng)
            self.note(**adversary.noted)
        self.note_gradients(losses, [features], step, added=losses.keys() & {"paired", "unpaired"})
        return losses

    def domains(self, features: Features, inputs: Inputs, stream: str, number: int) -> list[tuple[int, Cells]]:
        """All occupied cells of a frame; frames of the two clouds take turns."""
        del stream
        return [(number % 2, self.occupied(features, inputs))]

    def _paired(self, features: Features, cells: Cells, boxes: Sequence[Boxes], now: float) -> Tensor:
        chosen = self.settings.paired
        if isinstance(features, PointFeatures):
            raise ConfigError("method pattern: expected a detector with a map for loss: paired; points have no pairs.")
        fast = [_fast(frame_boxes, chosen.max_speed_m_s) for frame_boxes in boxes]
        still = cells[~inside(cells, fast, features.cell_m / 2)]
        nx, ny = features.values.shape[-2:]
        one, other = shared_cells(still, int(nx * ny))
        distance = pair_distance(values_at(features, one), values_at(features, other), chosen.form)
        loss = distance.sum() / normaliser(distance.new_tensor(float(len(one))))
        self.note(pairs=len(one) / max(len(boxes) // 2, 1))
        weight = chosen.weight * now
        return weight * loss if weight else loss.detach() * 0.0


def _fast(boxes: Boxes, speed_m_s: float) -> Boxes:
    """The boxes that are known to move faster."""
    if boxes.velocity_m_s is None:
        return boxes[:0]
    return boxes[np.linalg.norm(np.nan_to_num(boxes.velocity_m_s), axis=1) > speed_m_s]


def shared_cells(cells: Cells, cells_a_frame: int) -> tuple[Cells, Cells]:
    """The cells that are occupied in both frames 2k and 2k + 1, in one order.

    Args:
        cells: Occupied cells, ascending by frame and cell.
        cells_a_frame: Cells of the map.
    """
    key = torch.div(cells.frame, 2, rounding_mode="floor") * cells_a_frame + cells.cell
    even = cells.frame % 2 == 0
    one, other = even.nonzero().squeeze(1), (~even).nonzero().squeeze(1)
    shared = torch.isin(key[one], key[other]), torch.isin(key[other], key[one])
    return cells[one[shared[0]]], cells[other[shared[1]]]


def pair_distance(one: Tensor, other: Tensor, form: Literal["scale_free", "cosine", "plain"]) -> Tensor:
    """Distance between the features of each pair, shape (n,), float32.

    ``"plain"``: the squared distance over the channels. ``"scale_free"``: this over the mean variance of both, through
    which no gradient goes, so that smaller features are no nearer. ``"cosine"``: 1 - cosine.

    Args:
        one: Shape (n, c).
        other: Shape (n, c).
        form: Which distance.
    """
    one, other = one.float(), other.float()
    if form == "cosine":
        return 1 - functional.cosine_similarity(one, other, dim=1)
    distance = (one - other).square().mean(1)
    if form == "plain":
        return distance
    return 2 * distance / (common_variance(one) + common_variance(other))
