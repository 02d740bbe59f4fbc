"""Farfield: 3D object detection at long range and in all weather, on LiDAR and 4D radar.

The functions below import what they need when they are called, so that ``import farfield`` stays light.

>>> import farfield as ff
>>> data = ff.open_dataset("Cirrus_dataset1")      # the format is recognised   # doctest: +SKIP
"""

import importlib as _importlib
import importlib.metadata as _metadata
import typing as _typing
import warnings as _warnings
from functools import partial as _partial

from farfield._old_paths import install as _install_old_paths
from farfield.registry import register_display as _register_display

try:
    __version__ = _metadata.version("farfield")
except _metadata.PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

if _typing.TYPE_CHECKING:
    from farfield.api import (
        adapt,
        calibrate,
        detect,
        evaluate,
        export,
        load_detector,
        open_dataset,
        score,
        show,
        simulate,
        stream,
        train,
        transfer,
    )
    from farfield.datasets.base import Dataset
    from farfield.datasets.formats import dataset as register_dataset
    from farfield.detectors.spec import detector as register_detector
    from farfield.errors import FarfieldError
    from farfield.frame import Annotation, Cloud, Frame, Sensor, merge_clouds, transform_frame
    from farfield.frame.door import collate
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.detections import Detections
    from farfield.metrics.detections import protocol as register_protocol
    from farfield.metrics.result import Result
    from farfield.tracking import track

_HOMES = {
    "Annotation": "farfield.frame:Annotation",
    "Boxes": "farfield.geometry.boxes:Boxes",
    "Cloud": "farfield.frame:Cloud",
    "Dataset": "farfield.datasets.base:Dataset",
    "Detections": "farfield.metrics.detections:Detections",
    "FarfieldError": "farfield.errors:FarfieldError",
    "Frame": "farfield.frame:Frame",
    "Result": "farfield.metrics.result:Result",
    "Sensor": "farfield.frame:Sensor",
    "adapt": "farfield.api:adapt",
    "calibrate": "farfield.api:calibrate",
    "collate": "farfield.frame.door:collate",
    "detect": "farfield.api:detect",
    "evaluate": "farfield.api:evaluate",
    "export": "farfield.api:export",
    "load_detector": "farfield.api:load_detector",
    "merge_clouds": "farfield.frame:merge_clouds",
    "open_dataset": "farfield.api:open_dataset",
    "register_dataset": "farfield.datasets.formats:dataset",
    "register_detector": "farfield.detectors.spec:detector",
    "register_protocol": "farfield.metrics.detections:protocol",
    "score": "farfield.api:score",
    "show": "farfield.api:show",
    "simulate": "farfield.api:simulate",
    "stream": "farfield.api:stream",
    "track": "farfield.tracking:track",
    "train": "farfield.api:train",
    "transfer": "farfield.api:transfer",
    "transform_frame": "farfield.frame:transform_frame",
}
_ROOMS = ("metrics",)
"""Rooms that are reached as ``ff.metrics`` without an import of their own."""
_OLD_NAMES = {
    "dataset": "register_dataset",
    "detector": "register_detector",
    "joined": "merge_clouds",
    "moved": "transform_frame",
    "protocol": "register_protocol",
}
__all__ = [
    "Annotation",
    "Boxes",
    "Cloud",
    "Dataset",
    "Detections",
    "FarfieldError",
    "Frame",
    "Result",
    "Sensor",
    "adapt",
    "calibrate",
    "collate",
    "detect",
    "evaluate",
    "export",
    "load_detector",
    "merge_clouds",
    "open_dataset",
    "register_dataset",
    "register_detector",
    "register_protocol",
    "score",
    "show",
    "simulate",
    "stream",
    "track",
    "train",
    "transfer",
    "transform_frame",
]


def __getattr__(name: str) -> _typing.Any:
    if name in _OLD_NAMES:
        _warnings.warn(f"farfield.{name} is now farfield.{_OLD_NAMES[name]}", DeprecationWarning, stacklevel=2)
        name = _OLD_NAMES[name]
    if name in _ROOMS:
        return _importlib.import_module(f"farfield.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'farfield' has no attribute {name!r}")
    module, _, attribute = _HOMES[name].partition(":")
    return getattr(_importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def _draw(function: str, shown: object) -> str:
    """What a notebook shows; matplotlib is loaded when something is drawn."""
    html: str = getattr(_importlib.import_module("farfield.figures.notebook"), function)(shown)
    return html


_install_old_paths()
for _kind in ("boxes", "cloud", "detector", "frame", "result"):
    _register_display(_kind, _partial(_draw, f"{_kind}_html"))
