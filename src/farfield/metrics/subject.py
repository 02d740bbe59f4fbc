"""What a figure is about: who detected what in which data, and how that was counted."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.metrics.frames import frame_order

_SHOWN = 8
"""Digits of a fingerprint that people are shown; JSON has them all."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What a result is about. Every figure that is printed, drawn or stored stands beside one.

    Args:
        protocol: How it was scored, with its variant.
        label: The class that was scored, or the classes.
        detector: Who detected; empty where not known.
        detector_digest: SHA-256 of all that decides its boxes; empty where not known.
        data: Name of the data; empty for frames in memory.
        fingerprint: SHA-256 of the data's files, see :meth:`farfield.datasets.base.Dataset.fingerprint`; empty where
            there are none.
        labels_fingerprint: SHA-256 of the annotated boxes, see :func:`labels_fingerprint`.
        cloud: The cloud in which was detected; empty where not known.
        region: Which annotated boxes count, in words.
        annotated: Number of annotated objects that count.
        frames: Number of annotated frames.
        seen_in_training: What is known of the detector having learnt from these frames, in words.
    """

    protocol: str
    label: str
    detector: str = ""
    detector_digest: str = ""
    data: str = ""
    fingerprint: str = ""
    labels_fingerprint: str = ""
    cloud: str = ""
    region: str = ""
    annotated: int | None = None
    frames: int | None = None
    seen_in_training: str = "not known"

    @property
    def name(self) -> str:
        """Detector, data and cloud: what a row is called."""
        return self.of_data + (f", {self.cloud}" if self.cloud else "")

    @property
    def of_data(self) -> str:
        """Detector and data, without the cloud."""
        return f"{self.detector or 'given boxes'} on {self.data or 'frames in memory'}"

    def __str__(self) -> str:
        who = (self.detector or "given boxes") + _mark(self.detector_digest)
        what = (self.data or "frames in memory") + _mark(self.fingerprint or self.labels_fingerprint)
        objects = "objects not counted" if self.annotated is None else f"{self.annotated:,} objects"
        frames = "" if self.frames is None else f" in {self.frames:,} frames"
        seen = f"seen in training: {self.seen_in_training}"
        parts = [f"{who} on {what}", self.cloud and f"cloud {self.cloud}", self.label.replace("_", " ")]
        return "; ".join([*filter(None, parts), objects + frames, f"region {self.region}", self.protocol, seen])

    def to_json(self) -> dict[str, Any]:
        """The same as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, tree: Any) -> "Subject | None":
        """What :meth:`to_json` gave; None where a result, such as an older one, has no subject."""
        if not isinstance(tree, Mapping) or not all(isinstance(tree.get(name), str) for name in ("protocol", "label")):
            return None
        known: dict[str, Any] = {each.name: tree[each.name] for each in fields(cls) if each.name in tree}
        numbers = {"annotated", "frames"}
        good = {
            name: value
            for name, value in known.items()
            if (isinstance(value, int) if name in numbers else isinstance(value, str)) and not isinstance(value, bool)
        }
        return cls(**good)

    def same_data(self, other: "Subject") -> bool:
        """Whether both are of the same files and annotations, as far as both say."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("fingerprint", "labels_fingerprint")]
        return all(mine == theirs or not mine or not theirs for mine, theirs in pairs)


def _mark(digest: str) -> str:
    return f" [{digest[:_SHOWN]}]" if digest else ""


def subject_of(result: Mapping[str, Any]) -> Subject | None:
    """The subject of a result's JSON; None for one that was written before results had any."""
    return Subject.from_json(result.get("subject"))


def labels_fingerprint(annotations: Mapping[Key, Annotation]) -> str:
    """SHA-256 over the annotated boxes: frames, classes, and places, sizes and headings to a millimetre or milliradian.

    Unlike the fingerprint of a data set it does not depend on files: labels that were moved without a change of a
    file's size differ in it.
    """
    return digest_of((key, annotations[key]) for key in sorted(annotations, key=frame_order))


def digest_of(annotations: Iterable[tuple[Key, Annotation]]) -> str:
    """SHA-256 over annotations one after the other, see :func:`labels_fingerprint`."""
    digest = hashlib.sha256()
    for key, annotation in annotations:
        boxes = annotation.boxes
        digest.update("\0".join((*key, *map(str, np.asarray(boxes.label).tolist()))).encode() + b"\n")
        for values in (boxes.centre_m, boxes.size_m, boxes.yaw_rad):
            digest.update(np.rint(np.asarray(values, dtype=np.float64) * 1e3).astype(np.int64).tobytes())
    return digest.hexdigest()


def region_words(settings: Mapping[str, Any]) -> str:
    """Where annotated boxes count, in words, from a result's settings."""
    region, edges = settings.get("region"), settings.get("range_bins_m") or (0.0,)
    outermost = f"{_metres(edges[0])} to {_metres(edges[-1])} m"
    if region is None or region == "none":
        return "everywhere"
    if region == "range":
        return f"{outermost} around"
    if region == "window" and len(settings.get("window_m") or ()) == 4:
        x_from, x_to, y_from, y_to = map(_metres, settings["window_m"])
        return f"x {x_from} to {x_to} m, y {y_from} to {y_to} m, range {outermost}"
    azimuth = settings.get("azimuth_deg")
    within = "" if azimuth is None else f", azimuth to {azimuth:g} degrees"
    return (region if isinstance(region, str) else _bounds(region)) + within


def _bounds(bounds: Sequence[float]) -> str:
    pairs = zip("xyz", bounds[::2], bounds[1::2], strict=False)
    return ", ".join(f"{axis} {_metres(low)} to {_metres(high)} m" for axis, low, high in pairs)


def _metres(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)
