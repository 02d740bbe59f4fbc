"""Maps on frames by name: ``data.mapped(maps.make("sweeps", {"count": 4}))``."""

from farfield.datasets.frame_maps import MAPS, Earlier, FrameMap, described, make, none_before
from farfield.datasets.maps.annotations import AnnotatedField, LabelsAt, WholeBodies
from farfield.datasets.maps.common_radar import CommonRadar
from farfield.datasets.maps.coordinates import Coordinates, Move, TransformedCloud
from farfield.datasets.maps.sweeps import Posed, Sweeps

__all__ = [
    "MAPS",
    "AnnotatedField",
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
