"""Cirrus: reader, writer, mapping and labels of the two-pattern long-range LiDAR data set.

Names are imported when they are used, so that recognising a folder loads the layout alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from farfield.datasets.cirrus.labels import RawLabels
    from farfield.datasets.cirrus.layout import Mapping, read_mapping
    from farfield.datasets.cirrus.reader import Cirrus
    from farfield.datasets.cirrus.writer import CirrusWriter

_HOMES = {
    "Cirrus": "reader",
    "CirrusWriter": "writer",
    "Mapping": "layout",
    "RawLabels": "labels",
    "read_mapping": "layout",
}
__all__ = ["Cirrus", "CirrusWriter", "Mapping", "RawLabels", "read_mapping"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"farfield.datasets.cirrus.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
