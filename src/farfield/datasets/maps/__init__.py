"""Maps on frames by name: ``data.mapped(maps.make("sweeps", {"count": 4}))``."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from farfield.datasets.maps.annotations import LabelsAt, WholeBodies
from farfield.datasets.maps.common_radar import CommonRadar
from farfield.datasets.maps.contract import Earlier, FrameMap, described, none_before
from farfield.datasets.maps.coordinates import Coordinates, Move, TransformedCloud
from farfield.datasets.maps.sweeps import Posed, Sweeps
from farfield.errors import ConfigError, plain
from farfield.registry import Registry

__all__ = [
    "MAPS",
    "CommonRadar",
    "Coordinates",
    "Earlier",
    "FrameMap",
    "LabelsAt",
    "Move",
    "Posed",
    "Sweeps",
    "TransformedCloud",
    "WholeBodies",
    "described",
    "make",
    "none_before",
]

MAPS: Registry[Any] = Registry(
    "farfield.maps",
    "map of frames",
    {
        "common_radar": "farfield.datasets.maps.common_radar:CommonRadar",
        "coordinates": "farfield.datasets.maps.coordinates:Coordinates",
        "edited": "farfield.datasets.edits.edited:Edited",
        "labels_at": "farfield.datasets.maps.annotations:LabelsAt",
        "move": "farfield.datasets.maps.coordinates:Move",
        "posed": "farfield.datasets.maps.sweeps:Posed",
        "radar_view": "farfield.datasets.kradar.radar_cloud:RadarView",
        "sweeps": "farfield.datasets.maps.sweeps:Sweeps",
        "whole_bodies": "farfield.datasets.maps.annotations:WholeBodies",
    },
)


def make(name: str, settings: Mapping[str, Any]) -> FrameMap:
    """Make a map from its name and settings, such as a recipe has them.

    Args:
        name: One of :data:`MAPS`.
        settings: Its settings; those left out have their defaults.

    Raises:
        ConfigError: If there is no such map, or a setting is unknown or impossible.

    >>> make("sweeps", {"count": 4})
    Sweeps(count=4)
    """
    kind = MAPS[name]
    try:
        given = kind.Settings.model_validate(dict(settings))
    except ValidationError as error:
        known = ", ".join(kind.Settings.model_fields)
        raise ConfigError(f"map {name!r}: {plain(error)}. It has the settings {known}.") from error
    made: FrameMap = kind(**given.model_dump())
    return made
