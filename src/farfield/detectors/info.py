"""What is known of a detector, in one record, and plain functions as detectors. Needs no torch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

from farfield.frame import Cloud, Frame
from farfield.geometry.boxes import Boxes

DetectorFunction = Callable[[Frame | Cloud], Boxes]
"""Any function from a frame to scored boxes."""


@dataclass(frozen=True, kw_only=True)
class DetectorInfo:
    """What is known of a detector: what it reads, what it gives, and what it was trained on.

    Args:
        name: What it is called; empty if it has no name.
        network: Class of its network, such as ``"PointPillars"``; empty for a function.
        classes: The classes that it tells apart, by the names that it gives them; () if not known.
        sensor: Of which kind of sensor its clouds are; None if not known: any cloud may do.
        columns: Columns of the clouds that it reads, of all inputs together; () if not known.
        learnt_clouds: Names of the clouds that it was trained on; () if not known.
        reference: Name of the sensor in whose coordinates it was trained; None if not known.
        reach_m: How far ahead it looks, metres; None if not known.
        provenance: The record of its training, as its weights file holds it; empty if not known.
        family: What it learnt from, such as ``"simulation with open donors"``; empty if not known.
        places: Names of the real places whose sweeps it learnt from.
        precision: Number type of its convolutions, such as ``"bf16"``; empty for a function.
        score_threshold: Boxes of a lower score are not given; None if not known.
        nms_iou: Boxes that overlap a better one by more are not given; None if not known.
        max_boxes: Boxes given in a frame; None if not known.
    """

    name: str = ""
    network: str = ""
    classes: tuple[str, ...] = ()
    sensor: Literal["lidar", "radar"] | None = None
    columns: tuple[str, ...] = ()
    learnt_clouds: tuple[str, ...] = ()
    reference: str | None = None
    reach_m: float | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    family: str = ""
    places: tuple[str, ...] = ()
    precision: str = ""
    score_threshold: float | None = None
    nms_iou: float | None = None
    max_boxes: int | None = None

    @property
    def open_places(self) -> tuple[str, ...] | None:
        """Places of Open Sweeps that it learnt from, as its weights name them; None where they do not say."""
        return open_places(self.provenance)


def open_places(provenance: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Places of Open Sweeps that weights learnt from, () for none; None where it is not known.

    Args:
        provenance: The record of the training. Where sweeps or backgrounds of a place served, ``open_sweeps`` lists
            the places' names: in the record itself, in one of its ``streams``, in ``start`` or in ``adapted``, where
            None says that it is not known. Weights of simulated frames alone saw none.
    """
    streams = provenance.get("streams") or {}
    earlier = [provenance[name] for name in ("start", "adapted") if provenance.get(name)]
    lists = [record.get("open_sweeps") for record in (provenance, *streams.values(), *earlier)]
    if names := {str(name) for places in lists for name in places or ()}:
        return tuple(sorted(names))
    if provenance.get("open_sweeps") is not None:
        return ()
    data = (provenance.get("experiment") or {}).get("data") or {}
    by_stream = bool(data) and all(isinstance(group, Mapping) for group in data.values()) and "simulate" not in data
    groups = list(data.values()) if by_stream else [data]
    none_earlier = all(record.get("open_sweeps") == [] for record in earlier)
    return () if none_earlier and all(group.get("simulate") for group in groups) else None


SIMULATED_FAMILIES = ("simulation", "simulation with open donors")
"""Families of weights that learnt from no annotation of a real road but those of Open Sweeps."""


def family_with_start(provenance: Mapping[str, Any]) -> str:
    """What weights learnt from, those that their training started from included; empty where it is not known.

    Args:
        provenance: The record of the training. ``start`` says its ``family``; weights that were adapted have none.
    """
    data = (provenance.get("experiment") or {}).get("data") or {}
    family = str(provenance.get("family") or ("simulation" if data.get("simulate") else ""))
    start = provenance.get("start")
    if provenance.get("adapted") or (start and start.get("family") not in SIMULATED_FAMILIES):
        return ""
    return start["family"] if start and family == "simulation" else family


@runtime_checkable
class DescribedDetector(Protocol):
    """A detector that carries its description: a :class:`~farfield.detectors.runtime.Detector`, or a function's."""

    @property
    def info(self) -> DetectorInfo:
        """What is known of it."""

    def digest(self) -> str | None:
        """SHA-256 of all that decides its boxes; None if that cannot be computed."""

    def with_cloud(self, cloud: str | None) -> "DescribedDetector":
        """The same detector reading a certain cloud of a frame."""

    def __call__(self, frame: Frame | Cloud) -> Boxes:
        """Detect objects; boxes are in the frame's coordinates."""


@dataclass(frozen=True)
class FunctionDetector:
    """A plain function from a frame to scored boxes, with what it is known to be.

    Args:
        function: The function; it reads which cloud it likes.
        info: What is known of it.
    """

    function: DetectorFunction
    info: DetectorInfo = field(default_factory=DetectorInfo)

    def digest(self) -> str | None:
        """SHA-256 of all that decides its boxes, where the function has such a method; None otherwise."""
        digest = getattr(self.function, "digest", None)
        return None if digest is None else str(digest())

    def with_cloud(self, cloud: str | None) -> "FunctionDetector":
        """The same detector: a function chooses its cloud itself."""
        del cloud
        return self

    def __call__(self, frame: Frame | Cloud) -> Boxes:
        """Detect objects; boxes are in the frame's coordinates."""
        return self.function(frame)


def as_detector(detector: DescribedDetector | DetectorFunction) -> DescribedDetector:
    """A detector that carries its description: itself, or a function with what its attributes say of it.

    Of a function, or an object that is called like one, these attributes are read where it has them: ``name`` or
    ``__name__``, ``class_names``, ``kind``, ``learnt_clouds``, ``reference``, ``reach_m`` and ``provenance``. This is
    the only place that looks for attributes; everything behind it reads ``info``.
    """
    if isinstance(detector, DescribedDetector):
        return detector
    info = DetectorInfo(
        name=str(getattr(detector, "name", "") or getattr(detector, "__name__", "")),
        classes=tuple(getattr(detector, "class_names", ())),
        sensor=getattr(detector, "kind", None),
        learnt_clouds=tuple(getattr(detector, "learnt_clouds", ())),
        reference=getattr(detector, "reference", None),
        reach_m=getattr(detector, "reach_m", None),
        provenance=getattr(detector, "provenance", None) or {},
    )
    return FunctionDetector(detector, info)


def describe(detector: DescribedDetector | DetectorFunction) -> DetectorInfo:
    """What is known of a detector or a plain function; see :func:`as_detector`."""
    return as_detector(detector).info
