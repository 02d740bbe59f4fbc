"""What the configurations of all detectors share."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any, Protocol

import numpy as np
from jaxtyping import Float, Float32
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from farfield.geometry.boxes import Boxes

Channels = Annotated[int, Field(ge=1, le=4096)]
"""A number of features."""

POINT_COLUMNS = ("x_m", "y_m", "z_m", "intensity", "lag_s")
"""Columns of the points that networks read; ``lag_s`` is the age of a point's sweep, zero for a single sweep."""


class DetectorConfig(BaseModel, ABC):
    """Everything that decides the shape of a network and of its answers; each detector adds its own fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    score_threshold: float = Field(0.05, ge=0, le=1)
    nms_iou: float = Field(0.1, ge=0, le=1, description="boxes that overlap a better one by more are dropped")
    max_boxes: int = Field(500, ge=1, le=100_000, description="boxes kept in a frame")
    far_weight: float = Field(0.0, ge=0, description="extra weight of a box's loss per 100 m of range")

    @property
    @abstractmethod
    def class_names(self) -> tuple[str, ...]:
        """The classes that the detector tells apart."""

    @property
    def extra_columns(self) -> tuple[str, ...]:
        """Names of the columns of a cloud's ``extra`` that the network reads after those of ``POINT_COLUMNS``."""
        return ()

    @property
    @abstractmethod
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""

    def box_weights(self, boxes: Boxes) -> Float[np.ndarray, " n"]:
        """Weight of each box in the loss, from its range on the ground, shape (n,)."""
        return 1.0 + self.far_weight * np.hypot(boxes.centre_m[:, 0], boxes.centre_m[:, 1]) / 100.0


class Network(Protocol):
    """What a detector's network offers to the training loop and to the runtime.

    ``low_precision`` names the submodules that the runtime may turn into bfloat16.
    """

    config: DetectorConfig
    low_precision: tuple[str, ...]

    def __call__(self, clouds: Sequence[Tensor], targets: Sequence[Any] | None = None) -> Any:
        """Raw outputs for one tensor of points a frame, shape (n, 5 + k); only two-stage detectors look at targets."""

    def targets(self, boxes: Boxes, points: Float32[np.ndarray, "n columns"]) -> Any:
        """What one frame's annotation asks of the network; numpy, so that the loader's workers can do it."""

    def loss(self, outputs: Any, targets: Sequence[Any]) -> Any:
        """A named tuple with the parts of the loss over a batch; their sum is minimised."""

    def predict(self, clouds: Sequence[Tensor]) -> list[Boxes]:
        """Scored boxes of each frame, best first."""
