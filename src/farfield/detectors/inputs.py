"""What goes into a network: clouds as tensors whose columns have names, and batches of them by the inputs' names."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from farfield.detectors.devices import sent
from farfield.detectors.trained import cloud_rows
from farfield.errors import ConfigError
from farfield.frame import Cloud

POSITION = ("x_m", "y_m", "z_m")
"""The first columns of every cloud's tensor, metres."""

Positions = Literal["absolute", "relative"]
"""Whether an encoder describes a point by x and y too, or by its height and its place in its cell alone.

Near and far are functions of x: a discriminator between them can read them off features that hold it.
"""


@dataclass(frozen=True, kw_only=True)
class CloudInput:
    """One cloud that a network reads.

    Args:
        columns: Columns of the tensor, in this order, by the names of :meth:`farfield.frame.Cloud.column`; positions
            first. ``lag_s`` is the age of a point's sweep in seconds.

    Raises:
        ConfigError: If positions are not the first columns, or a column comes twice.
    """

    columns: tuple[str, ...] = (*POSITION, "intensity", "lag_s")

    def __post_init__(self) -> None:
        if self.columns[:3] != POSITION or len(set(self.columns)) < len(self.columns):
            raise ConfigError(
                f"CloudInput: expected {', '.join(POSITION)} and then each column once; got {self.columns}"
            )


def features_of(columns: Sequence[str]) -> list[int]:
    """Indices of the columns that are no position."""
    return [index for index, name in enumerate(columns) if name not in POSITION]


def cloud_tensor(cloud: Cloud, columns: Sequence[str]) -> Tensor:
    """A cloud as a tensor of the named columns, as :func:`~farfield.detectors.trained.cloud_rows` gives them."""
    return torch.from_numpy(cloud_rows(cloud, columns))


def stacked(clouds: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """The points of several frames, shape (n, c), and the frame number of each, shape (n,), int64."""
    points = clouds[0] if len(clouds) == 1 else torch.cat(list(clouds))
    frame = [torch.full((len(cloud),), number, device=points.device) for number, cloud in enumerate(clouds)]
    return points, frame[0] if len(clouds) == 1 else torch.cat(frame)


class Inputs(Mapping[str, list[Tensor]]):
    """The inputs of a batch of frames: one tensor a frame, by the input's name.

    ``a + b`` joins the frames of two batches, so that one forward sees both; ``len()`` counts frames.

    Args:
        named: Tensors by input; as many for each.

    Raises:
        ConfigError: If inputs have different numbers of frames.

    >>> one, two = Inputs({"points": [torch.zeros(4, 3)]}), Inputs({"points": [torch.zeros(0, 3)] * 2})
    >>> len(one + two), [len(cloud) for cloud in (one + two)["points"]]
    (3, [4, 0, 0])
    """

    def __init__(self, named: Mapping[str, Sequence[Tensor]]) -> None:
        self._named = {name: list(tensors) for name, tensors in named.items()}
        counts = {name: len(tensors) for name, tensors in self._named.items()}
        if len(set(counts.values())) != 1:
            raise ConfigError(f"Inputs: expected as many frames for each input; got {counts or 'no input'}")

    def __getitem__(self, name: str) -> list[Tensor]:
        return self._named[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._named)

    def __len__(self) -> int:
        return len(next(iter(self._named.values())))

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = None  # type: ignore[assignment]

    def __add__(self, other: "Inputs") -> "Inputs":
        if set(self) != set(other):
            raise ConfigError(f"Inputs: expected the same inputs to join; got {', '.join(self)} and {', '.join(other)}")
        return Inputs({name: [*tensors, *other[name]] for name, tensors in self._named.items()})

    def to(self, *target: Any, **options: Any) -> "Inputs":
        """The same inputs on another device or in another number type, as ``Tensor.to`` takes them."""
        named = self._named.items()
        return Inputs({name: [tensor.to(*target, **options) for tensor in tensors] for name, tensors in named})

    def on(self, device: torch.device) -> "Inputs":
        """The same inputs on a device; to a GPU through pinned memory, without waiting for the copies."""
        return Inputs({name: [sent(tensor, device) for tensor in tensors] for name, tensors in self._named.items()})
