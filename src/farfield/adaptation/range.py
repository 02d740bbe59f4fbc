"""Adaptation from near to far (Wang et al., ICCVW 2019, arXiv 1909.12249; Cirrus, section V.B).

Near range is the source and far range the target of one network that shares all parameters: nothing is added at
inference. Global: a discriminator tells the occupied cells of a near window from those of a far one of equal size, and
its gradient reaches the trunk reversed. Local: the feature of a far object is drawn to a mixture of near objects that
are like it. The paper's text leaves discriminator, weights, descriptor and schedule open: those here are ours.
"""

from collections.abc import Mapping
from typing import ClassVar, Literal, NamedTuple, cast

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.adaptation.adversarial import Adversarial, AdversarialLoss, discriminator, schedule
from farfield.adaptation.base import HELD_OUT, Adaptation
from farfield.adaptation.cells import (
    Cells,
    background_weight,
    inside,
    match_density,
    shown,
)
from farfield.adaptation.networks import start_from
from farfield.adaptation.objects import Memory, ObjectFeatures, effective_number, objects_of, similarity
from farfield.detectors.features import Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.losses import normaliser, sum_over_processes
from farfield.detectors.network import Network
from farfield.errors import ConfigError
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

_LEAST_ENTRIES = 8  # fewer have no spread to speak of


class GlobalAlignment(Adversarial):
    """The global loss."""

    match_density: bool = Field(False, description="draw near cells so that their point counts are the far ones'")
    balance_objects: bool = Field(True, description="weigh far background until objects have the near share of cells")


class LocalAlignment(MethodSettings):
    """The local loss; the paper's form, our numbers."""

    weight: float = Field(0.1, ge=0)
    tau: float = Field(0.2, gt=0, description="temperature of the similarity; n_eff in the log is to be 5 to 30 or so")
    size: int = Field(512, ge=8, description="near objects of a class that the memory keeps")
    max_age: int = Field(100, ge=1, description="steps after which an entry no longer counts")
    warmup: float = Field(0.2, ge=0, lt=1, description="share of the training before the loss begins")
    near_points: int = Field(20, ge=1, description="points that a near object enters the memory with")
    far_points: int = Field(1, ge=1, description="points that a far object takes part with")
    extent: Literal["full", "visible"] = Field("visible", description="what the boxes show; visible: no length, width")
    mixture: Literal["similar", "shuffled"] = Field("similar", description="shuffled: the control, permuted weights")


class RangeSettings(MethodSettings):
    """Which ranges are near and far, and which losses are on; ``null`` leaves one out."""

    near_m: tuple[float, float] = Field((0.0, 100.0), description="x of the near region")
    far_m: tuple[float, float] = Field((100.0, 250.0), description="x of the far region")
    half_width_m: float = Field(48.0, gt=0, description="both windows reach so far to each side")
    min_range_m: float = Field(10.0, ge=0, description="nearer cells are left out: the car's own shadow is there")
    global_: GlobalAlignment | None = Field(GlobalAlignment(), alias="global")
    local: LocalAlignment | None = LocalAlignment()
    start: str | None = Field(None, description="weights to start from")
    held_out: int = HELD_OUT

    @model_validator(mode="after")
    def _possible(self) -> "RangeSettings":
        near, far = (max(self.near_m[0], self.min_range_m), self.near_m[1]), self.far_m
        if not near[0] < near[1] <= far[0] < far[1]:
            raise ValueError(
                f"expected a near region that begins before it ends, beyond min_range_m, and a far one behind it; got "
                f"near {list(near)} and far {list(far)} m"
            )
        if self.global_ is None and self.local is None:
            raise ValueError("expected global or local, or both; without either use the method supervised")
        return self


class RangeWindows(NamedTuple):
    """Which cells count as near and as far: x from and to, half width, all in metres."""

    near_m: tuple[float, float]
    far_m: tuple[float, float]
    half_width_m: float

    def split(self, cells: Cells, min_range_m: float) -> tuple[Tensor, Tensor]:
        """Indices of the near and of the far cells."""
        x, y = cells.place_m.unbind(1)
        allowed = (y.abs() < self.half_width_m) & (cells.place_m.norm(dim=1) >= min_range_m)
        near, far = (((x >= a) & (x < b) & allowed).nonzero().squeeze(1) for a, b in (self.near_m, self.far_m))
        return near, far


def draw_windows(settings: RangeSettings, rng: np.random.Generator) -> RangeWindows:
    """Two windows of equal size; where a region is longer than the other, its window lies anywhere in it."""
    near, far = (max(settings.near_m[0], settings.min_range_m), settings.near_m[1]), settings.far_m
    length = min(near[1] - near[0], far[1] - far[0])
    starts = [rng.uniform(a, b - length) if b - a > length else a for a, b in (near, far)]
    near_m, far_m = ((float(start), float(start + length)) for start in starts)
    return RangeWindows(near_m, far_m, settings.half_width_m)


class RangeAdaptation(Adaptation):
    """Make far features like near ones while training on labelled frames.

    Args:
        network: The detector's network.
        **settings: See :class:`RangeSettings`.

    Raises:
        ConfigError: If a setting is unknown or does not fit.
    """

    streams: ClassVar[Mapping[str, Stream]] = {LABELLED: Stream(boxes=True)}

    def __init__(self, network: Network, **settings: object) -> None:
        super().__init__()
        self.settings = settings_of(RangeSettings, "range", settings)
        if self.settings.far_m[0] >= network.config.reach_m:
            raise ConfigError(
                f"method range: expected far_m to begin within the detector's reach, {network.config.reach_m:g} m; got "
                f"{list(self.settings.far_m)}."
            )
        if self.settings.start is not None:
            start_from(network, self.settings.start, "range")
        self.held_out = self.settings.held_out
        self.classes: tuple[str, ...] = tuple(network.config.class_names)
        self.modules = nn.ModuleDict({DETECTOR: network})
        if self.settings.global_ is not None:
            self.modules["discriminator"] = discriminator(network, self.settings.global_.form)
        if self.settings.local is not None:
            local, numbers = self.settings.local, 5 if self.settings.local.extent == "full" else 3
            self.modules["memory"] = Memory(
                len(self.classes), network.channels, numbers, size=local.size, max_age=local.max_age
            )

    def param_groups(self) -> Mapping[str, ParamGroup]:
        """The discriminator learns at its own rate."""
        return {} if self.settings.global_ is None else self.settings.global_.param_groups

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The network's own losses, and the global and the local one."""
        network, frames = self.network, batch[LABELLED]
        features = network.encode(frames.inputs)
        losses = detection_losses(network, features, frames.targets)
        rng = self.generator(step)
        if self.settings.global_ is not None:
            losses["global"] = self._global(self.settings.global_, features, frames, step, rng)
        if self.settings.local is not None:
            with torch.autocast(next(network.parameters()).device.type, enabled=False):
                losses["local"] = self._local(self.settings.local, features, frames, step, rng)
        self.note_gradients(losses, [features], step, added=losses.keys() & {"global", "local"})
        return losses

    def domains(self, features: Features, inputs: Inputs, stream: str, number: int) -> list[tuple[int, Cells]]:
        """Near and far cells of a frame, the same windows for all."""
        del stream, number
        cells = self.occupied(features, inputs)
        windows = draw_windows(self.settings, self.generator(0, shared=True))
        near, far = windows.split(cells, self.settings.min_range_m)
        return [(0, cells[near]), (1, cells[far])]

    def _global(
        self, chosen: GlobalAlignment, features: Features, frames: Batch, step: int, rng: np.random.Generator
    ) -> Tensor:
        cells = self.occupied(features, frames.inputs)
        windows = draw_windows(self.settings, self.generator(step, shared=True))
        near, far = windows.split(cells, self.settings.min_range_m)
        if chosen.match_density:
            near = near[match_density(cells.points[near], cells.points[far], rng)]
        both = cells[torch.cat([near, far])]
        domain = torch.zeros(len(both), device=both.row.device)
        domain[len(near) :] = 1.0
        weight = self._weights(chosen, both, domain, frames, float(getattr(features, "cell_m", 0.0)))
        self.note(near=shown(features, both[: len(near)]), far=shown(features, both[len(near) :]))
        adversary = AdversarialLoss(chosen, self.modules["discriminator"])
        loss = adversary(features, both, domain, schedule(self.progress(step)), rng, weight=weight)
        self.note(**adversary.noted)
        return loss

    @staticmethod
    def _weights(chosen: GlobalAlignment, both: Cells, domain: Tensor, frames: Batch, cell_m: float) -> Tensor:
        """Weights under which far cells belong to objects as often as near ones do."""
        weight = torch.ones_like(domain)
        if chosen.balance_objects:
            objects, far = inside(both, frames.boxes, cell_m / 2), domain == 1
            counts = torch.stack([part.sum().float() for part in (objects & ~far, ~far, objects & far, far)])
            weight[far & ~objects] = background_weight(*sum_over_processes(counts).tolist())
        return weight

    def _local(
        self, chosen: LocalAlignment, features: Features, frames: Batch, step: int, rng: np.random.Generator
    ) -> Tensor:
        every = objects_of(features, frames.boxes, self.classes, chosen.extent)
        near = every.chosen((every.range_m < self.settings.near_m[1]) & (every.points >= chosen.near_points))
        memory = cast(Memory, self.modules["memory"])
        memory.add(near.kind, near.feature, near.descriptor, step)
        far = (every.range_m >= self.settings.far_m[0]) & (every.points >= chosen.far_points)
        weight = chosen.weight * schedule(self.progress(step)) * (self.progress(step) >= chosen.warmup)
        loss = self._drawn_near(chosen, memory, every.chosen(far), step, rng)
        return weight * loss if weight else loss.detach() * 0.0

    def _drawn_near(
        self, chosen: LocalAlignment, memory: Memory, far: ObjectFeatures, step: int, rng: np.random.Generator
    ) -> Tensor:
        """The local loss without its weight: the mean over the far objects of all processes."""
        total, numbers, taking = far.feature.sum() * 0.0, [], 0
        for kind in range(len(self.classes)):
            entries = memory.entries(kind, step)
            objects = far.chosen(far.kind == kind)
            if len(entries.feature) < _LEAST_ENTRIES or not len(objects.kind):
                continue
            weights = similarity(objects.descriptor, entries.descriptor, chosen.tau)
            if chosen.mixture == "shuffled":
                weights = weights[:, torch.from_numpy(rng.permutation(weights.shape[1])).to(weights.device)]
            total = total + local_error(objects.feature, weights @ entries.feature, entries.feature)
            numbers.append(effective_number(weights))
            taking += len(objects.kind)
        self.note(n_eff=torch.cat(numbers).mean() if numbers else float("nan"), local_objects=float(taking))
        return total / normaliser(total.new_tensor(float(taking)))


def local_error(feature: Tensor, mixture: Tensor, near: Tensor) -> Tensor:
    """Sum over far objects of ||f_t - mixture||^2 over the channels and the variance of near features.

    No gradient reaches mixture and near features, so these do not degrade; with both divisors a weight means the same
    for each network.

    Args:
        feature: f_t, shape (n, c).
        mixture: The similarity-weighted means, shape (n, c).
        near: The features of the memory, shape (m, c).
    """
    variance = near.detach().var(0, correction=0).mean().clamp(min=1e-6)
    return (feature - mixture.detach()).square().sum() / feature.shape[1] / variance
