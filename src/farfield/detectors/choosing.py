"""Which of its boxes a detector gives, by score, overlap, number and class: chosen as it is loaded, not trained."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError

from farfield.detectors import build_detector
from farfield.detectors.contract import Network
from farfield.errors import ConfigError, plain
from farfield.geometry.boxes import Boxes

Classes = Iterable[str] | Mapping[str, str]
"""Classes to give, or for each of them the name to give it."""


@dataclass(frozen=True)
class ChosenClasses:
    """Some of a detector's classes, perhaps under other names.

    Args:
        names: The name to give each chosen class.
        max_boxes: Boxes of the chosen classes that are kept in a frame.
    """

    names: Mapping[str, str]
    max_boxes: int

    @classmethod
    def of(cls, wanted: Classes, known: tuple[str, ...], max_boxes: int) -> "ChosenClasses":
        """Check a choice.

        Args:
            wanted: The choice.
            known: The detector's own classes.
            max_boxes: As of the class.

        Raises:
            ConfigError: If it names none, or one that the detector does not know.
        """
        names = dict(wanted) if isinstance(wanted, Mapping) else {name: name for name in wanted}
        unknown = [name for name in names if name not in known]
        if unknown or not names or not all(names.values()):
            raise ConfigError(
                f"classes: expected at least one class that the detector knows ({', '.join(known)}), each with the "
                f"name to give it or none; got {', '.join(unknown or names) or 'none'}."
            )
        return cls(names, max_boxes)

    @property
    def given(self) -> tuple[str, ...]:
        """The names that boxes can have."""
        return tuple(dict.fromkeys(self.names.values()))

    def __call__(self, boxes: Boxes) -> Boxes:
        """The boxes of these classes, under the names to give."""
        chosen = boxes[np.isin(boxes.label, list(self.names))][: self.max_boxes]
        labels = np.array([self.names[str(name)] for name in chosen.label], dtype=np.str_)
        return chosen.replace(label=labels) if len(chosen) else chosen


def reconfigured(network: Network, changes: Mapping[str, Any]) -> Network:
    """The same network, its weights shared, with some settings changed that no weight depends on.

    It is built anew, so that a setting counts wherever the network looks at it.

    Args:
        network: Before anything in it is folded.
        changes: Fields of its configuration; those that are None stay.

    Raises:
        ConfigError: If a value is not possible.
    """
    changes = {name: value for name, value in changes.items() if value is not None}
    if not changes:
        return network
    try:
        config = type(network.config).model_validate({**network.config.model_dump(), **changes})
    except ValidationError as error:
        raise ConfigError(f"{plain(error)}.") from error
    with torch.device("meta"):
        other = build_detector(config)
    other.load_state_dict(network.state_dict(), assign=True)
    return other.train(network.training)
