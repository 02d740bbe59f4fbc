"""A detector's network: from named inputs to features, from features to losses or boxes."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, final, runtime_checkable

import numpy as np
import torch
from torch import Tensor, nn

from farfield.detectors.config import DetectorConfig
from farfield.detectors.features import Features
from farfield.detectors.inputs import CloudInput
from farfield.detectors.soundness import has_nan
from farfield.detectors.spec import DETECTORS
from farfield.errors import ConfigError, FarfieldError
from farfield.geometry.boxes import Boxes

FIXED = (
    "config: the settings made the network's parts; another configuration would be ignored there. Choose what to keep "
    "as the detector is loaded: load_detector(name, score_threshold=, nms_iou=, max_boxes=, classes=)."
)
"""Why a configuration is not exchanged."""

ClassRows = Mapping[str, tuple[int, Sequence[Any]]]
"""By names of tensors: along which axis rows belong to classes, and what each row is, such as (class, heading, number);
equal in two networks where they mean the same."""


class AnchorRow(NamedTuple):
    """A row that gives a number of an anchor's box: in units of the anchor, so that another of its size can have it.

    Attributes:
        label: The anchor's class.
        heading: Which of its headings.
        number: Which number.
    """

    label: str
    heading: int
    number: int


InputColumns = Mapping[str, tuple[int, Sequence[str]]]
"""By names of tensors that meet a network's input: along which axis its columns lie, and what each is."""


@runtime_checkable
class Assigner(Protocol):
    """Turns a frame's annotation into targets, in numpy and without the network: loader's workers hold it alone."""

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> Any:
        """Targets of one frame.

        Args:
            boxes: Its annotated boxes.
            inputs: What the network reads of it, by the inputs' names, each of shape (n, columns).
        """


class Network(nn.Module, ABC):
    """From named inputs to features, from features to outputs, from those to losses or boxes.

    A subclass sets what is declared here and defines the four abstract methods' work; ``head`` is a submodule of that
    name, or a method. It is declared and not defined: a method of this class would hide the submodule and its weights.

    Args:
        config: The detector's settings.

    Attributes:
        inputs: What it reads, by name.
        work: What it mostly does, which decides the number type on some processors.
        channels: Features of a row of what :meth:`encode` gives.
        low_precision: Submodules that the runtime may turn into bfloat16.
        assigner: Makes targets of annotations.
        head: ``head(features, targets=None)``: outputs of features; only two-stage detectors look at the targets.
    """

    inputs: Mapping[str, CloudInput]
    channels: int
    low_precision: ClassVar[tuple[str, ...]] = ()
    work: ClassVar[Literal["dense", "rows"]] = "dense"
    assigner: Assigner
    head: Callable[..., Any]

    def __init__(self, config: DetectorConfig) -> None:
        super().__init__()
        self._config = config

    @property
    def config(self) -> Any:
        """The detector's settings: they made its parts and stay as they are."""
        return self._config

    @config.setter
    def config(self, config: Any) -> None:
        """Refuse another one."""
        if config is not self._config:
            raise ConfigError(FIXED)

    @abstractmethod
    def encode(self, batch: Mapping[str, list[Tensor]]) -> Features:
        """Features of a batch.

        Args:
            batch: One tensor a frame for each of ``inputs``, shape (n, columns).
        """

    @abstractmethod
    def losses(self, outputs: Any, targets: Sequence[Any]) -> dict[str, Tensor]:
        """The parts of the loss over a batch by name, scalars; their sum is minimised.

        Each is normalised by what counts in the batches of all processes (``processes.normaliser``).
        """

    @abstractmethod
    def decode(self, outputs: Any) -> list[Boxes]:
        """Scored boxes of each frame, best first."""

    def class_rows(self) -> ClassRows:
        """Which rows of which tensors are of which class: what loading weights with other classes goes by."""
        return {}

    def input_columns(self) -> InputColumns:
        """Which columns of the input the first tensors read: what loading weights of other columns goes by."""
        return {}

    @final  # type: ignore[misc]  # torch declares an attribute
    def forward(self, batch: Mapping[str, list[Tensor]], targets: Sequence[Any] | None = None) -> Any:
        """Outputs of the head for a batch; see :meth:`encode`."""
        return self.head(self.encode(batch), targets)

    @final
    @torch.no_grad()
    def predict(self, batch: Mapping[str, list[Tensor]]) -> list[Boxes]:
        """Detect: scored boxes of each frame of a batch, best first.

        Raises:
            FarfieldError: If the outputs hold NaN: of damaged weights, or sums that the number type does not hold.
        """
        outputs = self(batch)
        if has_nan(outputs):
            raise FarfieldError(
                f"{self.config.name}: expected scores, got what is not a number: weights are damaged, a cloud holds "
                "absurd values, or the number type overflows. Take precision fp32, or other weights."
            )
        return self.decode(outputs)


class MapDetector(Network):
    """A network whose head, a submodule, makes the losses and the boxes too."""

    head: Any

    def losses(self, outputs: Any, targets: Sequence[Any]) -> dict[str, Tensor]:
        """The head's losses over a batch."""
        losses: dict[str, Tensor] = self.head.losses(outputs, targets)
        return losses

    def decode(self, outputs: Any) -> list[Boxes]:
        """The head's boxes of each frame, best first."""
        boxes: list[Boxes] = self.head.decode(outputs)
        return boxes

    def class_rows(self) -> ClassRows:
        """Those of the head, if it says them."""
        rows: ClassRows = self.head.class_rows() if hasattr(self.head, "class_rows") else {}
        return {f"head.{name}": meaning for name, meaning in rows.items()}


def build_detector(config: DetectorConfig, *, seed: int | None = None) -> Network:
    """Build the untrained network that a configuration describes; a seed makes its weights repeatable.

    Raises:
        ConfigError: If there is no detector of the configuration's name.
    """
    network: type[Network] = DETECTORS[config.name].network_class
    if seed is not None:
        torch.manual_seed(seed)
    return network(config)
