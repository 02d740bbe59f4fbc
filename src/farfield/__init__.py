"""Farfield: 3D object detection at long range and in all weather, on LiDAR and 4D radar.

The functions below import what they need when they are called, so that ``import farfield`` stays light.

>>> import farfield as ff
>>> data = ff.open_dataset("Cirrus_dataset1")      # the format is recognised   # doctest: +SKIP
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

try:
    __version__ = version("farfield")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

if TYPE_CHECKING:
    from farfield.api import evaluate, load_detector, open_dataset, show
    from farfield.errors import FarfieldError
    from farfield.frame import Cloud, Frame
    from farfield.geometry.boxes import Boxes

_HOMES = {
    "Boxes": "farfield.geometry.boxes",
    "Cloud": "farfield.frame",
    "Frame": "farfield.frame",
    "FarfieldError": "farfield.errors",
    "evaluate": "farfield.api",
    "load_detector": "farfield.api",
    "open_dataset": "farfield.api",
    "show": "farfield.api",
}
__all__ = ["Boxes", "Cloud", "FarfieldError", "Frame", "evaluate", "load_detector", "open_dataset", "show"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'farfield' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
