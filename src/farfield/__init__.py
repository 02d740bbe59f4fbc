"""Farfield: 3D object detection at long range and in all weather, on LiDAR and 4D radar.

The functions below import what they need when they are called, so that ``import farfield`` stays light.

>>> import farfield as ff
>>> data = ff.open_dataset("Cirrus_dataset1")      # the format is recognised   # doctest: +SKIP
"""

import warnings
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

try:
    __version__ = version("farfield")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

if TYPE_CHECKING:
    from farfield.api import adapt, detect, evaluate, load_detector, open_dataset, show, train, transfer
    from farfield.datasets.formats import dataset
    from farfield.detectors.spec import detector
    from farfield.errors import FarfieldError
    from farfield.frame import Annotation, Cloud, Frame, Sensor, merge_clouds, transform_frame
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.protocol import protocol
    from farfield.tracking import track

_HOMES = {
    "Annotation": "farfield.frame",
    "Boxes": "farfield.geometry.boxes",
    "Cloud": "farfield.frame",
    "FarfieldError": "farfield.errors",
    "Frame": "farfield.frame",
    "Sensor": "farfield.frame",
    "adapt": "farfield.api",
    "dataset": "farfield.datasets.formats",
    "detect": "farfield.api",
    "detector": "farfield.detectors.spec",
    "evaluate": "farfield.api",
    "load_detector": "farfield.api",
    "merge_clouds": "farfield.frame",
    "open_dataset": "farfield.api",
    "protocol": "farfield.metrics.protocol",
    "show": "farfield.api",
    "track": "farfield.tracking",
    "train": "farfield.api",
    "transfer": "farfield.api",
    "transform_frame": "farfield.frame",
}
_RENAMED = {"joined": "merge_clouds", "moved": "transform_frame"}
__all__ = [
    "Annotation",
    "Boxes",
    "Cloud",
    "FarfieldError",
    "Frame",
    "Sensor",
    "adapt",
    "dataset",
    "detect",
    "detector",
    "evaluate",
    "load_detector",
    "merge_clouds",
    "open_dataset",
    "protocol",
    "show",
    "track",
    "train",
    "transfer",
    "transform_frame",
]


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warnings.warn(f"farfield.{name} is now farfield.{_RENAMED[name]}", DeprecationWarning, stacklevel=2)
        name = _RENAMED[name]
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'farfield' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
