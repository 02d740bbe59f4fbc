"""Adaptation from one device to another (Cirrus, section V.B, Table IV: KITTI to Cirrus).

The trunk is shared, and each domain has a head of its own, since their boxes differ (full bodies, visible parts). A
discriminator tells the devices by the features of occupied cells, those of unlabelled target frames included, and its
gradient reaches the trunk reversed. How many target frames are labelled is the experiment's (``data.target.part``).
"""

from collections.abc import Mapping
from typing import Literal

from pydantic import Field
from torch import Tensor, nn

from farfield.adaptation.adversarial import Adversarial, AdversarialLoss, discriminator, schedule
from farfield.adaptation.base import HELD_OUT, Adaptation, weighted_losses
from farfield.adaptation.cells import Cells, shown
from farfield.adaptation.networks import start_from, with_own_head, with_own_statistics
from farfield.detectors.features import Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.network import Network
from farfield.training.method import (
    DETECTOR,
    Batch,
    MethodSettings,
    ParamGroup,
    Stream,
    detection_losses,
    network_of,
    settings_of,
)

_SOURCE, _TARGET, _REST = "source", "target", "rest"


class DeviceSettings(MethodSettings):
    """What the domains share, and how a discriminator tells the devices; all are ours."""

    adversarial: Adversarial | None = Field(Adversarial(), description="null: both devices, no further loss")
    norm: Literal["shared", "per_domain"] = Field(
        "shared", description="one forward of all frames with its statistics, or statistics by domain"
    )
    rest: bool = Field(False, description="read unlabelled target frames too, for the discriminator: data.rest")
    rest_share: float = Field(1.0, gt=0, description="unlabelled target frames in a batch over labelled ones")
    source_weight: float = Field(1.0, ge=0, description="of the source's losses")
    min_range_m: float = Field(0.0, ge=0, description="nearer cells do not count for the discriminator")
    max_range_m: float = Field(1e3, gt=0, description="nor farther ones: beyond it the source has no points")
    start: str | None = Field(None, description="weights to start from, such as the source detector's")
    held_out: int = HELD_OUT


class DeviceAdaptation(Adaptation):
    """Learn from labelled frames of two devices with one trunk and two heads.

    ``weights.safetensors`` is the target's detector and ``weights_source.safetensors`` the source's.

    Args:
        network: The detector's network: the target's.
        **settings: See :class:`DeviceSettings`.

    Raises:
        ConfigError: If a setting is unknown or does not fit, or the detector's head is no module.
    """

    def __init__(self, network: Network, **settings: object) -> None:
        super().__init__()
        self.settings = settings_of(DeviceSettings, "device", settings)
        self.held_out = self.settings.held_out
        streams = {_SOURCE: Stream(), _TARGET: Stream()}
        if self.settings.rest:
            streams[_REST] = Stream(labelled=False, share=self.settings.rest_share)
        self.streams = streams  # type: ignore[misc]
        if self.settings.start is not None:
            start_from(network, self.settings.start, "device")
        own = self.settings.norm == "per_domain"
        twin = with_own_statistics(network, own_head=True) if own else with_own_head(network)
        self.modules = nn.ModuleDict({DETECTOR: network, _SOURCE: twin})
        if self.settings.adversarial is not None:
            self.modules["discriminator"] = discriminator(network, self.settings.adversarial.form)

    def param_groups(self) -> Mapping[str, ParamGroup]:
        """The discriminator learns at its own rate."""
        return {} if self.settings.adversarial is None else self.settings.adversarial.param_groups

    def exported(self) -> Mapping[str, str]:
        """The target's detector, and the source's beside it."""
        return {"weights": DETECTOR, "weights_source": _SOURCE}

    def meant_for(self) -> Mapping[str, str]:
        """Each is for its own domain."""
        return {"weights": _TARGET, "weights_source": _SOURCE}

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The losses of both heads, and the discriminator's."""
        source, target = self._features(batch)
        losses = self._of_head(self.network, target, batch[_TARGET], "target", 1.0)
        losses |= self._of_head(
            network_of(self.modules, _SOURCE), source, batch[_SOURCE], "source", self.settings.source_weight
        )
        if self.settings.adversarial is not None:
            losses["device"] = self._adversarial(batch, source, target, step)
        self.note_gradients(losses, [source, target], step, added=losses.keys() & {"device"})
        return losses

    def reader(self, stream: str) -> Network:
        """Each domain has its own head, and perhaps statistics."""
        return network_of(self.modules, _SOURCE if stream == _SOURCE else DETECTOR)

    def domains(self, features: Features, inputs: Inputs, stream: str, number: int) -> list[tuple[int, Cells]]:
        """The cells of a frame that count; its stream is its domain."""
        del number
        return [(int(stream != _SOURCE), self._cells(features, inputs))]

    def _features(self, batch: Mapping[str, Batch]) -> tuple[Features, Features]:
        """Features of the source's frames, and of the target's, labelled ones first."""
        of_target = batch[_TARGET].inputs
        if _REST in batch:
            of_target = of_target + batch[_REST].inputs
        network, count = self.network, len(batch[_SOURCE])
        if self.settings.norm == "per_domain":
            return network_of(self.modules, _SOURCE).encode(batch[_SOURCE].inputs), network.encode(of_target)
        source, target = network.encode(batch[_SOURCE].inputs + of_target).split(count)
        return source, target

    @staticmethod
    def _of_head(network: Network, features: Features, frames: Batch, name: str, weight: float) -> dict[str, Tensor]:
        if len(features) > len(frames):
            features, _ = features.split(len(frames))
        return weighted_losses(detection_losses(network, features, frames.targets), name, weight)

    def _adversarial(self, batch: Mapping[str, Batch], source: Features, target: Features, step: int) -> Tensor:
        """The mean of each device's cells; the features of both are judged one after the other."""
        assert self.settings.adversarial is not None
        of_target = batch[_TARGET].inputs + batch[_REST].inputs if _REST in batch else batch[_TARGET].inputs
        one, other = self._cells(source, batch[_SOURCE].inputs), self._cells(target, of_target)
        self.note(source=shown(source, one), target=shown(target, other))
        adversary = AdversarialLoss(self.settings.adversarial, self.modules["discriminator"])
        now = schedule(self.progress(step))
        loss = adversary.between((source, one), (target, other), now, self.generator(step))
        self.note(**adversary.noted)
        return loss

    def _cells(self, features: Features, inputs: Inputs) -> Cells:
        cells = self.occupied(features, inputs)
        range_m = cells.place_m.norm(dim=1)
        return cells[(range_m >= self.settings.min_range_m) & (range_m < self.settings.max_range_m)]
