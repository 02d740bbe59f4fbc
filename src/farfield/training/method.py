"""What a training does with its batches: modules that it trains, streams of samples that it reads, losses.

The loop owns the rest: optimiser, schedule, averages, checkpoints, processes.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, TypeVar, cast

import torch
from pydantic import ConfigDict, ValidationError
from torch import Tensor, nn

from farfield.detectors.features import Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.network import Network
from farfield.errors import ConfigError, fault_of
from farfield.files.yaml_text import PlainSettings
from farfield.geometry.boxes import Boxes
from farfield.registry import Registry, take_old_methods

DETECTOR = "detector"
"""Name of the module that becomes the detector's weights file."""

LABELLED = "labelled"
"""Name of the one stream of a supervised training."""

Optimise = Callable[[Mapping[str, Tensor], Collection[str]], None]
"""Takes losses and names of modules: minimises the losses' sum over these modules' parameters, one step."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """A named stream of training samples.

    Args:
        labelled: Whether its frames are annotated; otherwise their annotations, if any, are not looked at.
        share: Its part of each batch, relative to those of the other streams.
        members: How the clouds of a frame, if several are read in turn, come into a batch. ``"mixed"``: each is a
            sample of its own. ``"paired"``: the samples of a frame follow one another, with the same objects pasted and
            the same random motion. ``"apart"``: they take turns as if paired, each from another frame.
        boxes: Whether its batches hold the frames' boxes, each with the number of points in it.
        changed: Whether its frames are changed at random; otherwise they come as they are.
    """

    labelled: bool = True
    share: float = 1.0
    members: Literal["mixed", "paired", "apart"] = "mixed"
    boxes: bool = False
    changed: bool = True


@dataclass(frozen=True, kw_only=True)
class ParamGroup:
    """How a module is trained where it is not trained as the others are.

    Args:
        rate: Its learning rate over the loop's.
        clip: Largest norm of its own gradient, which then does not count in that of the others.
    """

    rate: float = 1.0
    clip: float = 1.0


@dataclass(frozen=True)
class Batch:
    """The frames of one stream in a step.

    Args:
        inputs: What the network reads, by input: one tensor a frame.
        targets: Targets of each frame by the network's assigner; empty for an unlabelled stream.
        boxes: Boxes of each frame with their point counts, for a stream that wants them; else empty.
    """

    inputs: Inputs
    targets: Sequence[Any] = field(default_factory=list)
    boxes: Sequence[Boxes] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.inputs)


class Method(ABC):
    """A way to train. A subclass sets ``modules`` and names its streams.

    Attributes:
        streams: The streams that it reads; the data of each are the experiment's ``data.<name>``, for a single stream
            ``data`` itself.
        modules: All that is saved, averaged, spread to other processes and synchronised; ``modules["detector"]`` is a
            :class:`~farfield.detectors.network.Network` and is exported.
        held_out: Frames of each stream that are not trained on and that :meth:`inspect` looks at.
    """

    streams: ClassVar[Mapping[str, Stream]] = {LABELLED: Stream()}
    modules: nn.ModuleDict
    held_out: int = 0

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        take_old_methods(cls, begins="on_train_start", paces="param_groups")

    @abstractmethod
    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The losses of a batch by name; their sum is minimised, and each is a column of the log.

        A loss that is a mean must be one over all processes: divide a sum by
        :func:`farfield.detectors.losses.normaliser`.

        Args:
            batch: The frames of each stream. ``inputs`` of several streams can be added, so that one forward pass, and
                with it one set of batch statistics, is that of the mixture.
            step: Number of the step, from 0.
        """

    def on_train_start(self, steps: int, seed: int) -> None:  # noqa: B027 - most methods have nothing to do
        """Called before the first step, also of a training that goes on.

        Args:
            steps: Steps of the whole training.
            seed: Its seed: what the method draws at random is to be a function of it and of the step.
        """

    def param_groups(self) -> Mapping[str, ParamGroup]:
        """Modules with a learning rate and a limit of the gradient of their own, such as a discriminator."""
        return {}

    def figures(self) -> Mapping[str, float]:
        """What is logged beside the losses of the last step, in the first process; called at logged steps only."""
        return {}

    def inspect(self, batch: Mapping[str, Batch]) -> Mapping[str, float]:
        """What is logged of held-out frames, at each tenth of the training and at its end; nothing may change.

        Args:
            batch: All held-out frames of each stream, as they are.
        """
        del batch
        return {}

    def frozen(self) -> Collection[str]:
        """Names of modules that are not trained by gradients, such as a teacher."""
        return ()

    def after_step(self, step: int) -> None:  # noqa: B027 - most methods have nothing to do
        """Called after each step, such as to move a teacher's average."""

    def step(self, batch: Mapping[str, Batch], step: int, optimise: Optimise) -> dict[str, Tensor] | None:
        """A step of its own, such as of players that take turns; None leaves it to the loop.

        Args:
            batch: The frames of each stream.
            step: Number of the step, from 0.
            optimise: Minimises some losses over some modules; it may be called several times.

        Returns:
            The losses for the log.
        """
        del batch, step, optimise
        return None

    def exported(self) -> Mapping[str, str]:
        """Weights files to write at the end, by their names without suffix: which module each holds."""
        return {"weights": DETECTOR}

    def meant_for(self) -> Mapping[str, str]:
        """Of weights files, by their names without suffix, the stream whose clouds they are to read.

        Those of files that are not named are the experiment's first stream's.
        """
        return {}


class MethodSettings(PlainSettings):
    """Settings of a method, or of a part of it; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


Settings = TypeVar("Settings", bound=MethodSettings)


def settings_of(kind: type[Settings], method: str, settings: Mapping[str, Any]) -> Settings:
    """Check the settings of a method.

    Raises:
        ConfigError: If one is unknown or does not fit; the message names each.
    """
    try:
        return kind.model_validate(dict(settings))
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, item['loc'])) or 'settings'}: {fault_of(item)}" for item in error.errors()]
        names = ", ".join(field.alias or name for name, field in kind.model_fields.items())
        raise ConfigError(
            f"method {method}: {len(lines)} setting(s) do not fit:\n" + "\n".join(lines) + f"\nIt has: {names}."
        ) from error


class Supervised(Method):
    """Train a detector on annotated frames.

    Args:
        network: The detector's network.
    """

    def __init__(self, network: Network) -> None:
        self.modules = nn.ModuleDict({DETECTOR: network})

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The network's own losses."""
        del step
        network, frames = network_of(self.modules), batch[LABELLED]
        return detection_losses(network, network.encode(frames.inputs), frames.targets)


METHODS: Registry[Callable[..., Method]] = Registry(
    "farfield.methods",
    "training method",
    {
        "supervised": "farfield.training.method:Supervised",
        "mixed": "farfield.training.mixed:MixedSupervision",
        "continued": "farfield.adaptation.continued:ContinuedTraining",
        "range": "farfield.adaptation.range:RangeAdaptation",
        "device": "farfield.adaptation.device:DeviceAdaptation",
        "pattern": "farfield.adaptation.pattern:PatternAdaptation",
        "teacher": "farfield.adaptation.teacher:MeanTeacher",
    },
)
"""Methods by name: each is called with the detector's network and the experiment's further ``method`` settings."""


def network_of(modules: nn.ModuleDict, name: str = DETECTOR) -> Network:
    """The module of that name, which is a network."""
    return cast(Network, modules[name])


def detection_losses(network: Network, features: Features, targets: Sequence[Any]) -> dict[str, Tensor]:
    """The network's own losses of features that it encoded, by name, summed in float32."""
    outputs = network.head(features, targets)
    with torch.autocast(next(network.parameters()).device.type, enabled=False):
        return network.losses(outputs, targets)


def total_of(losses: Mapping[str, Tensor]) -> Tensor:
    """Sum of the losses, added in their order.

    Raises:
        ConfigError: If there is none.
    """
    if not losses:
        raise ConfigError("Expected a training method to give at least one loss; got none.")
    first, *others = losses.values()
    return sum(others, start=first)
