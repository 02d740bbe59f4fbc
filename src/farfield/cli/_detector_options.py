"""Flags of every verb that loads a detector: which of its boxes it gives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from farfield.cli._words import names
from farfield.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class DetectorOptions:
    """The flags; what is not given is the weights' own."""

    score_threshold: float | None = None
    """Boxes below this score are left out; the weights' own threshold unless given."""
    nms_iou: float | None = None
    """Boxes that overlap a better one by more are left out; the weights' own unless given."""
    max_boxes: int | None = None
    """Boxes kept in a frame; the weights' own number unless given."""
    classes: str = ""
    """Classes to keep, comma-separated, such as vehicle,pedestrian; OLD:NEW renames, such as vehicle:Car,bicycle."""

    @property
    def options(self) -> dict[str, Any]:
        """What ``load_detector`` takes."""
        return {
            "score_threshold": self.score_threshold,
            "nms_iou": self.nms_iou,
            "max_boxes": self.max_boxes,
            "classes": mapping(self.classes, "--classes") if self.classes else None,
        }

    @property
    def said(self) -> dict[str, Any]:
        """The flags that were given, by name."""
        return {name: value for name, value in vars(self).items() if value not in (None, "")}


BoxFlags = Annotated[DetectorOptions, tyro.conf.arg(name="")]
"""A parameter of a verb whose fields are flags of their own."""

OWN = DetectorOptions()
"""No flag is given."""


def mapping(text: str, flag: str) -> Mapping[str, str]:
    """Comma-separated words ``name`` or ``old:new`` as a mapping.

    Raises:
        ConfigError: If a word is neither, or a name stands twice.
    """
    found: dict[str, str] = {}
    for word in names(text):
        old, colon, new = (part.strip() for part in word.partition(":"))
        if not old or (colon and not new) or old in found:
            raise ConfigError(f"{flag}: expected each name once, as name or old:new, got {word!r}")
        found[old] = new or old
    return found
