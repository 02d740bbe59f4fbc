"""Detections: what was found in the frames of a data set, with all that scores it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np
from jaxtyping import Bool, Shaped

from farfield.errors import ConfigError
from farfield.files.spool import MappedView, alike
from farfield.frame.annotation import Annotation, CameraField
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import BoxesByFrame, labels_of
from farfield.metrics.oddities import meant_by, strange_classes
from farfield.metrics.protocol import PROTOCOLS, Protocol, relabel_of
from farfield.metrics.result import Result
from farfield.metrics.subject import Subject, labels_fingerprint, region_words

Details = Mapping[str, Shaped[np.ndarray, "n *rest"]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Detections:
    """Predictions by (sequence, frame), what was annotated there, and what is known of both.

    Args:
        boxes: Scored boxes by frame; an annotated frame without an entry has none.
        annotations: Annotations of the frames that have one, those without boxes included. No other frame counts.
        reference: Name of the coordinates of both, such as ``"os2-64"``; empty where not known.
        cloud: The cloud in which was detected.
        classes: Classes that the detector knows.
        drives: The drives that hold the frames, with times and poses; none where frames are shuffled.
        conditions: ``weather``, ``road``, ``time`` of the frames, where known.
        facts: What else is known of the data, such as ``label_version``.
        prediction_details: Rows beside the predictions, such as KITTI's ``box_px`` (n, 4).
        ms: Time that each frame took, milliseconds.
        reach_m: How far the detector sees; None where not known.
        notes: What was assumed so far, one sentence each.
        detector: Name of the detector; empty where not known, and so are the next four.
        detector_digest: SHA-256 of all that decides its boxes.
        data: Name of the data.
        fingerprint: SHA-256 of the data's files.
        labels_fingerprint: SHA-256 of the annotated boxes as the data has them; unless given, of the annotations here.
        seen_in_training: What is known of the detector having learnt from these frames, in words.
    """

    boxes: BoxesByFrame
    annotations: Mapping[Key, Annotation]
    reference: str = ""
    cloud: str | None = None
    classes: tuple[str, ...] = ()
    drives: tuple[Drive, ...] = ()
    conditions: Mapping[Key, Mapping[str, str]] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    prediction_details: Mapping[Key, Details] = field(default_factory=dict)
    ms: tuple[float, ...] = ()
    reach_m: float | None = None
    notes: tuple[str, ...] = ()
    detector: str = ""
    detector_digest: str = ""
    data: str = ""
    fingerprint: str = ""
    labels_fingerprint: str = ""
    seen_in_training: str = "not known"

    def __repr__(self) -> str:
        boxes = sum(map(len, self.boxes.values()))
        return f"Detections({boxes} boxes in {len(self.boxes)} frames, {len(self.annotations)} annotated)"

    @property
    def annotated(self) -> BoxesByFrame:
        """The annotated boxes by frame."""
        return MappedView(self.annotations, attrgetter("boxes"))

    def replaced(self, boxes: BoxesByFrame) -> "Detections":
        """The same with other boxes, as a tracker gives them."""
        return replace(self, boxes=boxes, prediction_details={})

    def score(self, protocol: str | Protocol = "dds", **settings: Any) -> Result:
        """Score the boxes.

        Frames without annotation do not count, nor do boxes outside the region that was annotated. A range bin that
        begins beyond the detector's reach has no figure. The result's notes say so.

        Args:
            protocol: Its name, such as ``"dds"`` or ``"kradar-compat:rtnh_wide"``, or the object.
            **settings: The protocol's settings: ``label``, ``range_bins_m``, ``region``, ``bootstrap``...

        Raises:
            ConfigError: If the protocol or a setting is unknown, or no frame with predictions is annotated.
        """
        chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
        found = self.counted()
        return self._noted(self._about(found.evaluated(chosen, chosen.settings(found, **settings))))

    def score_each(self, protocol: str | Protocol = "dds", **settings: Any) -> list[Result]:
        """Score every annotated class, each for itself, the most frequent first; or that of ``label`` alone.

        A protocol that scores several classes at once gives one result. Arguments and errors are those of
        :meth:`score`; a label that no box bears is a ConfigError too.
        """
        chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
        found = self.counted()
        return [self._noted(self._about(found.evaluated(chosen, each))) for each in chosen.each(found, **settings)]

    def _about(self, result: Result) -> Result:
        """The result with its subject: the one place where subjects are made."""
        counted = result.counts.get("annotated")
        subject = Subject(
            protocol=result.protocol,
            label=self._counted_label(result),
            detector=self.detector,
            detector_digest=self.detector_digest,
            data=self.data,
            fingerprint=self.fingerprint,
            labels_fingerprint=self.labels_fingerprint or labels_fingerprint(self.annotations),
            cloud=self.cloud or "",
            region=region_words(result.settings),
            annotated=counted if isinstance(counted, int) else self._number_of(result.label),
            frames=len(self.annotations),
            seen_in_training=self.seen_in_training,
        )
        return replace(result, subject=subject)

    @property
    def paired(self) -> int:
        """Number of frames that have both predicted and annotated boxes."""
        return sum(key in self.boxes and len(boxes) > 0 < len(self.boxes[key]) for key, boxes in self.annotated.items())

    def check_label(self, protocol: str | Protocol, label: str | None = None, **given: Any) -> None:
        """Refuse a class that no annotated box bears or that the detector does not know: figures would be null or 0.

        Args:
            protocol: The protocol, which may count classes as others.
            label: The class; None: the protocol chooses.
            **given: Further settings of the protocol.

        Raises:
            ConfigError: If there are annotated boxes, and none is of the class, or of any that the detector knows.
        """
        chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
        if chosen.several_classes:
            if "label" not in chosen.options():
                chosen.each(self, label=label, **given)
            return
        relabel = relabel_of(chosen, given)
        counts = dict(labels_of(self.annotated, relabel))
        known = dict.fromkeys(relabel.get(name, name) for name in self.classes)
        if known and counts and not (set(counts) & set(known) if label is None else label in known):
            asked = ", ".join(f"{name} ({count})" for name, count in counts.items()) if label is None else label
            raise ConfigError(
                f"label: expected a class that the detector knows, one of {', '.join(known)}; got {asked}. "
                + _advice(counts, known, label)
            )
        if label is None:
            return
        if counts and label not in counts:
            guess = meant_by(label, counts)
            shown = ", ".join(f"{name} ({count})" for name, count in counts.items())
            raise ConfigError(
                f"label: expected an annotated class, one of {shown}; got {label!r}"
                + (f". Did you mean {guess}?" if guess else "")
            )

    def _noted(self, result: Result) -> Result:
        """The result with notes on classes and regions in which nothing can be found."""
        relabel = result.settings.get("relabel") or {}
        notes = [] if self.classes else strange_classes(self.boxes, self.annotated, relabel)
        there = sum(count for name, count in labels_of(self.annotated, relabel) if name == result.label)
        if result.counts.get("annotated") == 0 and there:
            notes.append(
                f"0 of {there} annotated boxes of {result.label} lie in the region ({region_words(result.settings)}): "
                "--region none takes them all"
            )
        return replace(result, notes=(*result.notes, *notes))

    def _counted_label(self, result: Result) -> str:
        """The class that was scored, and which annotated classes counted as it: "vehicle with large_vehicle"."""
        there = {name for boxes in self.annotated.values() for name in np.unique(boxes.label).tolist()}
        merged = result.settings.get("relabel") or {}
        others = sorted(name for name, other in merged.items() if other == result.label and name in there)
        return f"{result.label} with {' and '.join(others)}" if others else result.label

    def _number_of(self, label: str) -> int:
        return sum(int(np.count_nonzero(boxes.label == label)) for boxes in self.annotated.values())

    def evaluated(self, protocol: Protocol, settings: Any) -> Result:
        """Evaluate detections that count (see :meth:`counted`) with the settings of a protocol."""
        result = protocol.evaluate(self, settings)
        convention = result.convention or protocol.convention_text(result.settings)
        noted = replace(result, convention=convention, notes=(*self.notes, *result.notes))
        return _within_reach(noted, self.reach_m)

    def counted(self) -> "Detections":
        """The frames and boxes that count, an entry of boxes for every annotated frame, and notes on what is left out.

        Raises:
            ConfigError: If there are predictions and none lies in an annotated frame.
        """
        strangers = [key for key in self.boxes if key not in self.annotations]
        if strangers and len(strangers) == len(self.boxes):
            raise ConfigError(
                f"expected predictions in annotated frames, got none in common: predictions hold {strangers[0]}, "
                f"annotations {next(iter(self.annotations), 'nothing')}. A score needs frames that are annotated."
            )
        notes = list(self.notes)
        if strangers:
            notes.append(f"{len(strangers)} of {len(self.boxes)} frames are not annotated and do not count")
        boxes, annotations, details, left = alike(self.boxes), alike(self.annotations), {}, _OutsideCounts()
        for key, annotation in self.annotations.items():
            found, known = self.boxes.get(key, _NOTHING), self.prediction_details.get(key)
            if annotation.region is not None:
                seen, there = _inside(found, annotation.region), _inside(annotation.boxes, annotation.region)
                left.add(annotation.region, seen, there)
                found = found if seen.all() else found[seen]
                annotation = annotation if there.all() else annotation[there]
                known = None if known is None else {name: np.asarray(rows)[seen] for name, rows in known.items()}
            boxes[key], annotations[key] = found, annotation
            if known is not None:
                details[key] = known
        return replace(
            self,
            boxes=boxes,
            annotations=annotations,
            prediction_details=details,
            conditions={key: self.conditions[key] for key in annotations if key in self.conditions},
            notes=(*notes, *left.notes()),
        )


_NOTHING = Boxes.empty(scored=True)


def _advice(counts: Mapping[str, int], known: Mapping[str, None], label: str | None) -> str:
    """What to do where a class is asked for that the detector does not know, or where annotated ones are none of its.

    Args:
        counts: Annotated boxes by class.
        known: The detector's classes.
        label: The class that was asked for, if one was.
    """
    shared = [name for name in counts if name in known]
    if label is not None and label not in counts and shared:
        return f"Take an annotated one: --label {' or '.join(shared)}"
    guess = next((f"{name}:{meant}" for name in counts if (meant := meant_by(name, known))), "")
    guess = guess or f"{label if label in counts else next(iter(counts))}:{next(iter(known))}"
    return f"Name what is meant with --options relabel={guess} (relabel=, a mapping, in Python)"


def _inside(boxes: Boxes, region: CameraField) -> Bool[np.ndarray, " n"]:
    return region.contains(boxes.centre_m) if len(boxes) else np.zeros(0, dtype=bool)


class _OutsideCounts:
    """Counts of the boxes outside the annotated regions."""

    def __init__(self) -> None:
        self.sums: dict[str, tuple[int, ...]] = {}

    def add(self, region: CameraField, predicted: Bool[np.ndarray, " n"], annotated: Bool[np.ndarray, " m"]) -> None:
        """Count the boxes of a frame; the masks mark those inside."""
        before = self.sums.get(str(region), (0, 0, 0, 0))
        here = (int((~predicted).sum()), int((~annotated).sum()), len(predicted), len(annotated))
        self.sums[str(region)] = tuple(a + b for a, b in zip(before, here, strict=True))

    def notes(self) -> list[str]:
        """A sentence for each region with boxes outside it."""
        return [
            f"{predicted} of {all_predicted} predicted and {annotated} of {all_annotated} annotated boxes have their "
            f"centre outside {region}, where nothing was annotated; they do not count"
            for region, (predicted, annotated, all_predicted, all_annotated) in self.sums.items()
            if predicted or annotated
        ]


def _within_reach(result: Result, reach_m: float | None) -> Result:
    """A result whose range bins beyond the detector's reach are null, with notes that say so."""
    if reach_m is None:
        return result
    edges_m = [float(edge) for edge in result.settings.get("range_bins_m") or ()]
    named = {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(edges_m)}
    scored = [name for name in named if any(v is not None for v in result.ranges.get(name, {}).values())]
    beyond = [name for name in scored if named[name][0] >= reach_m]
    partly = [name for name in scored if named[name][0] < reach_m < named[name][1]]
    notes = list(result.notes)
    if beyond:
        notes.append(f"range {', '.join(beyond)} m begins beyond the detector's reach of {reach_m:g} m: not scored")
    if partly:
        notes.append(f"range {', '.join(partly)} m ends beyond the detector's reach of {reach_m:g} m")
    return replace(result.without(beyond), notes=tuple(notes))
