"""Detections, and the protocols that score them: two halves of one contract.

:class:`Detections` are the boxes of a detector by frame with what was annotated there; a :class:`Protocol` turns them
into a :class:`~farfield.metrics.result.Result`. ``detections.score("dds", range_bins_m=(0, 70))`` looks the protocol up
by its name, lets it complete its settings, evaluates the frames that count, and says of what the figures are.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from itertools import pairwise
from operator import attrgetter
from typing import Any, ClassVar, TypeVar

import numpy as np
from jaxtyping import Shaped

from farfield.errors import ConfigError, FarfieldError
from farfield.files.disk_dict import MappedView, alike
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.annotated_fields import OutsideCounts, inside_field
from farfield.metrics.bootstrap import Weighted
from farfield.metrics.frames import BoxesByFrame, check_crowd, labels_of
from farfield.metrics.options import check_numbers, merged_relabel, option_text, with_bootstrap
from farfield.metrics.presenting import Presentation, Presenter
from farfield.metrics.result import (
    Result,
    Subject,
    figure_names,
    labels_fingerprint,
    region_words,
    value_at,
    without_lone_intervals,
    without_ranges,
)
from farfield.metrics.sanity import class_notes, one_sided, sanity_warnings
from farfield.registry import PluginError, Registry
from farfield.vocabulary.classes import CIRRUS_CLASSES, closest_class

Details = Mapping[str, Shaped[np.ndarray, "n *rest"]]


P = TypeVar("P", bound="type[Protocol]")
_NUMBERS = ("range_bins_m", "epsilons")
"""Settings that are numbers: whole ones and lists are taken too, and give the same JSON."""


class Protocol(ABC):
    """A way to score detections.

    A protocol of one class has a setting ``label``; without one given the most annotated class is scored, of those that
    the detector knows where there are any. Settings
    named ``relabel``, ``ignore``, ``range_bins_m``, ``region`` and ``bootstrap`` mean what they mean in
    :class:`farfield.metrics.centre.settings.CentreSettings`.

    Args:
        variant: What follows the colon in the protocol's name.

    Raises:
        ConfigError: If the protocol has no variants.
    """

    name: ClassVar[str] = ""
    """What it is called in ``score`` and on the command line."""
    family: ClassVar[str] = ""
    """Protocols of one family share columns where their settings agree; empty: the name."""
    Settings: ClassVar[type[Any]]
    """A frozen dataclass whose fields all have defaults: they are the flags."""
    uses: ClassVar[frozenset[str]] = frozenset()
    """What it takes of the detections besides boxes: ``"conditions"``, ``"visibility"``, ``"details"``."""
    several_classes: ClassVar[bool] = False
    """Whether one result holds several classes, named by the setting ``classes``, as ``ap/CLASS/...``."""
    classes: ClassVar[Mapping[str, str]] = {name: name for name in CIRRUS_CLASSES if name != "unknown"}
    """All classes of the data that it is for, ours by the data's own name."""
    presenter: ClassVar[Presenter] = Presenter()
    """How tables and pages show its figures."""

    def __init__(self, variant: str = "") -> None:
        if variant:
            raise ConfigError(f"protocol {self.name!r} has no variants, got {variant!r} after the colon")

    def __str__(self) -> str:
        return self.name

    @abstractmethod
    def evaluate(self, detections: "Detections", settings: Any) -> Result:
        """Score detections whose every annotated frame has an entry of boxes; settings are a ``Settings``."""

    def weighted(self, detections: "Detections", settings: Any) -> Weighted:
        """The same figures as functions of group weights, from which differences of results are drawn.

        Args:
            detections: Detections that count, as ``evaluate`` takes them.
            settings: A ``Settings``.

        Raises:
            ConfigError: If the protocol does not say how its figures depend on weights.
        """
        del detections, settings
        raise ConfigError(
            f"protocol {self}: expected one whose figures can be resampled, to decide on differences; got one without. "
            "Give its class a method weighted(detections, settings), or choose dds, nuscenes, argoverse2, waymo, kitti "
            "or kradar"
        )

    def options(self) -> tuple[str, ...]:
        """Names of the settings."""
        return tuple(field.name for field in fields(self.Settings))

    def default(self, name: str) -> Any:
        """The default of a setting; None where there is no such setting."""
        return getattr(self.Settings(), name, None)

    def settings(self, detections: "Detections", **options: Any) -> Any:
        """The settings of a score: those given, and defaults of which some depend on the data.

        Raises:
            ConfigError: If a setting is unknown or impossible.
        """
        options = with_bootstrap(self.options(), options)
        unknown = sorted(set(options) - set(self.options()))
        if unknown:
            expected = ", ".join(self.options())
            raise ConfigError(f"{self}: expected options among {expected}; got {', '.join(unknown)}")
        edges_and_weights = {name: options[name] for name in _NUMBERS if options.get(name) is not None}
        options |= {name: tuple(map(float, values)) for name, values in edges_and_weights.items()}
        options = self.with_own_relabel(options)
        if "label" in self.options() and options.get("label") is None:
            options = {name: value for name, value in options.items() if name != "label"}
            present = self.labels(detections.annotated, **options)
            relabel = relabel_of(self, options)
            detected = {relabel.get(name, name) for name in detections.classes}
            options |= {"label": next((name for name in present if name in detected), present[0])} if present else {}
        return self.Settings(**options)

    def with_own_relabel(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Options whose ``relabel`` is added to the protocol's own; see :func:`merged_relabel`."""
        chosen = options.get("relabel") if "relabel" in self.options() else None
        if chosen is None:
            return dict(options)
        return {**options, "relabel": merged_relabel(getattr(self.Settings(), "relabel", None) or {}, chosen)}

    def labels(self, boxes: BoxesByFrame, **options: Any) -> tuple[str, ...]:
        """Classes that can be scored, the most frequent first: relabelled ones as one, ignored ones left out."""
        options = self.with_own_relabel(options)
        chosen = {name: options[name] for name in ("relabel", "ignore") if name in options and name in self.options()}
        default = self.Settings(**chosen)
        names = (name for name, _ in labels_of(boxes, getattr(default, "relabel", {})))
        return tuple(name for name in names if name not in (getattr(default, "ignore", None) or ()))

    def each(self, detections: "Detections", *, label: str | None = None, **options: Any) -> list[Any]:
        """The settings of one result a class, the most annotated class first.

        Args:
            detections: The detections.
            label: The only class to score; None for every annotated one.
            **options: Further settings.

        Raises:
            ConfigError: If no box bears the label, or a setting is unknown or impossible.
        """
        if "label" not in self.options():
            return [self.settings(detections, **options)]
        detections.check_label(self, label, **options)
        present = self.labels(detections.annotated, **options)
        names = [label] if label is not None else present or (None,)
        return [self.settings(detections, label=name, **options) for name in names]

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The few figures that stand for a result: for the terminal, ``compare-results`` and the page.

        Args:
            result: Result JSON, or a part of it (a range bin, a condition).

        Returns:
            Figures by name, such as ``"dds/0/dds"``, the first one first; all figures unless the protocol chooses.
        """
        return {name: value_at(result, name) for name in figure_names(result)}

    def compared(self, result: Mapping[str, Any]) -> Collection[str]:
        """Of a result of several classes those of which ``compare-results`` has a table each, as ``ap/CLASS/...``.

        Args:
            result: Result JSON.
        """
        return tuple((result.get("settings") or {}).get("classes") or ())

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """Settings on which no figure of the whole depends, so that results that differ in them share a column.

        Args:
            settings: Settings of a result's JSON.
        """
        names = ["bootstrap", "label"]
        region = settings.get("region")
        return [*names, *(["window_m"] * (region != "window")), *(["range_bins_m"] * (region == "none"))]

    def depends_on(self, settings: Mapping[str, Any], *, by_range: bool = False) -> dict[str, Any]:
        """The settings on which figures depend; ``by_range`` for those of range bins, on which the bins bear."""
        inert = set(self.inert(settings)) - ({"range_bins_m"} if by_range else set())
        return {name: value for name, value in settings.items() if name not in inert}

    def convention_text(self, settings: Mapping[str, Any], *, by_range: bool = False) -> str:
        """The settings on which figures depend, as one line of ``name=value`` pairs."""
        return option_text(self.depends_on(settings, by_range=by_range))


def relabel_of(protocol: Protocol, options: Mapping[str, Any]) -> Mapping[str, str]:
    """Which class names a protocol counts as others, under the settings that are given."""
    options = protocol.with_own_relabel(options)
    chosen = {name: options[name] for name in ("relabel",) if name in options and name in protocol.options()}
    relabel: Mapping[str, str] = getattr(protocol.Settings(**chosen), "relabel", None) or {}
    return relabel


class ForeignProtocol(Protocol):
    """A protocol known from its results only: that of a package that is not installed here."""

    def __init__(self, variant: str = "") -> None:
        self.known_as = variant

    def __str__(self) -> str:
        return self.known_as

    def evaluate(self, detections: "Detections", settings: Any) -> Result:
        """Refuse.

        Raises:
            ConfigError: Always.
        """
        del detections, settings
        raise ConfigError(f"protocol {self.known_as!r} is not installed here")


class Protocols(Registry[Any]):
    """Protocols by name; what follows a colon is the variant: ``PROTOCOLS["kradar-compat:rtnh_wide"]``."""

    def __getitem__(self, name: str) -> Protocol:
        kind, colon, variant = name.partition(":")
        registered: Any = super().__getitem__(kind)
        if isinstance(registered, type):
            registered = registered(variant) if colon else registered()
        if not isinstance(registered, Protocol):
            raise PluginError(
                f"protocol {kind!r} of {self.origin(kind)} cannot be used: expected a class that inherits "
                f"farfield.metrics.Protocol, or an object of one; got {registered!r}"
            )
        return registered


PROTOCOLS = Protocols(
    "farfield.protocols",
    "protocol",
    {
        "dds": "farfield.metrics.centre.dds:Dds",
        "nuscenes": "farfield.metrics.centre.nuscenes:NuScenes",
        "nuscenes-detection": "farfield.metrics.centre.nuscenes_detection:DetectionTask",
        "open-sweeps": "farfield.metrics.centre.open_sweeps:OpenSweepsProtocol",
        "kitti": "farfield.metrics.kitti.protocol:KittiProtocol",
        "kradar": "farfield.metrics.kradar.protocol:KRadarProtocol",
        "kradar-compat": "farfield.metrics.kradar.protocol:KRadarCompat",
        "argoverse2": "farfield.metrics.argoverse2.protocol:Argoverse2Protocol",
        "waymo": "farfield.metrics.waymo.protocol:WaymoProtocol",
        "waymo-let": "farfield.metrics.waymo.protocol:WaymoLetProtocol",
        "tracking": "farfield.metrics.tracking.protocol:Tracking",
        "nuscenes-tracking": "farfield.metrics.tracking.nuscenes:NuScenesTracking",
    },
)


def protocol(name: str) -> Callable[[P], P]:
    """Register a protocol's class in this process, as a notebook does.

    Args:
        name: What it is called from then on.

    Raises:
        ConfigError: If the name is a built-in one, or the class is no protocol.
    """
    return partial(_register, name)


def _register(name: str, kind: P) -> P:
    if not (isinstance(kind, type) and issubclass(kind, Protocol)):
        raise ConfigError(f"protocol {name!r}: expected a class that inherits farfield.metrics.Protocol, got {kind!r}")
    registered = PROTOCOLS.register(name)(kind)
    registered.name = name
    return registered


def protocol_of(result: Mapping[str, Any]) -> Protocol:
    """The protocol of a result's JSON, whether or not it is installed here."""
    name = str(result.get("protocol", ""))
    try:
        return PROTOCOLS[name]
    except FarfieldError:
        return ForeignProtocol(name)


def presentation_of(result: Mapping[str, Any], protocol: Protocol | None = None) -> Presentation:
    """What a page shows of a result's JSON, as the presenter of its protocol says; None: the one that it names."""
    chosen = protocol_of(result) if protocol is None else protocol
    shown = chosen.presenter.presentation(result)
    return shown if shown.figures else replace(shown, figures=tuple(chosen.headline(result)))


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
        checked: Whether the notes say already what is odd about the boxes, see :attr:`oddities`.
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
    checked: bool = False

    def __repr__(self) -> str:
        boxes = sum(map(len, self.boxes.values()))
        return f"Detections({boxes} boxes in {len(self.boxes)} frames, {len(self.annotations)} annotated)"

    @property
    def annotated(self) -> BoxesByFrame:
        """The annotated boxes by frame."""
        return MappedView(self.annotations, attrgetter("boxes"))

    @cached_property
    def oddities(self) -> tuple[str, ...]:
        """What is odd about the boxes, one sentence each: see :mod:`farfield.metrics.sanity`."""
        return tuple(sanity_warnings(self.boxes, self.annotated))

    def with_oddities(self) -> "Detections":
        """The same with a note on each oddity."""
        return self if self.checked else replace(self, notes=(*self.notes, *self.oddities), checked=True)

    def replaced(self, boxes: BoxesByFrame) -> "Detections":
        """The same with other boxes, as a tracker gives them."""
        return replace(self, boxes=boxes, prediction_details={})

    def score(self, protocol: str | Protocol = "dds", **settings: Any) -> Result:
        """Score the boxes.

        Frames without annotation do not count, nor do boxes outside the region that was annotated. A range bin that
        begins beyond the detector's reach has no figure. The result's notes say so, and what is odd about the boxes.

        Args:
            protocol: Its name, such as ``"dds"`` or ``"kradar-compat:rtnh_wide"``, or the object.
            **settings: The protocol's settings: ``label``, ``range_bins_m``, ``region``, ``bootstrap``...

        Raises:
            ConfigError: If the protocol or a setting is unknown, or no frame with predictions is annotated.
        """
        chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
        counted = self.counted()
        result = self._described(counted.evaluated(chosen, chosen.settings(counted, **settings)))
        return self._with_relabel_notes(result, settings)

    def score_each(self, protocol: str | Protocol = "dds", **settings: Any) -> list[Result]:
        """Score every annotated class, each for itself, the most frequent first; or that of ``label`` alone.

        A protocol that scores several classes at once gives one result. Arguments and errors are those of
        :meth:`score`; a label that no box bears is a ConfigError too.
        """
        chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
        counted = self.counted()
        results = [self._described(counted.evaluated(chosen, one)) for one in chosen.each(counted, **settings)]
        return [self._with_relabel_notes(result, settings) for result in results]

    def _with_relabel_notes(self, result: Result, settings: Mapping[str, Any]) -> Result:
        """The result with a note on the classes that count as others although the relabel given names them not."""
        relabel = settings.get("relabel")
        if not relabel:
            return result
        merged = result.settings.get("relabel") or {}
        present = {name for side in (self.annotated, self.boxes) for name, _ in labels_of(side, {})}
        own = {old: new for old, new in merged.items() if old not in relabel and old in present and old != new}
        notes = [
            f"{old} counts as {new} too, as the protocol has it (relabel={old}:{old} keeps it apart)"
            for old, new in own.items()
        ]
        return replace(result, notes=(*result.notes, *notes))

    def _described(self, result: Result) -> Result:
        """The result with its subject, and with notes on classes and regions in which nothing can be found."""
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
            annotated=counted
            if isinstance(counted, int)
            else sum(int(np.count_nonzero(boxes.label == result.label)) for boxes in self.annotated.values()),
            frames=len(self.annotations),
            seen_in_training=self.seen_in_training,
        )
        relabel = result.settings.get("relabel") or {}
        notes = [] if self.checked else list(self.oddities)
        notes += one_sided(self.boxes, self.annotated, result.settings)
        notes += class_notes(self.boxes, self.annotated, relabel, with_strange=not self.classes)
        annotated = sum(count for name, count in labels_of(self.annotated, relabel) if name == result.label)
        if counted == 0 and annotated:
            notes.append(
                f"0 of {annotated} annotated boxes of {result.label} lie in the region "
                f"({region_words(result.settings)}): --region none takes them all"
            )
        return replace(result, subject=subject, notes=(*result.notes, *notes))

    @property
    def paired(self) -> int:
        """Number of frames that have both predicted and annotated boxes."""
        return sum(key in self.boxes and len(boxes) > 0 < len(self.boxes[key]) for key, boxes in self.annotated.items())

    def shared_classes(self, relabel: Mapping[str, str]) -> set[str]:
        """Classes that predicted and annotated boxes have both, once ``relabel`` has named them."""
        predicted, annotated = ({name for name, _ in labels_of(side, relabel)} for side in (self.boxes, self.annotated))
        return predicted & annotated

    def check_label(self, protocol: str | Protocol, label: str | None = None, **options: Any) -> None:
        """Refuse a class that no annotated box bears or that the detector does not know: figures would be null or 0.

        Args:
            protocol: The protocol, which may count classes as others.
            label: The class; None: the protocol chooses.
            **options: Further settings of the protocol.

        Raises:
            ConfigError: If there are annotated boxes, and none is of the class, or of any that the detector knows.
        """
        chosen = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
        if chosen.several_classes:
            if "label" not in chosen.options():
                chosen.each(self, label=label, **options)
            return
        relabel = relabel_of(chosen, options)
        counts = dict(labels_of(self.annotated, relabel))
        detected = dict.fromkeys(relabel.get(name, name) for name in self.classes)
        if detected and counts and not (set(counts) & set(detected) if label is None else label in detected):
            names = ", ".join(f"{name} ({count})" for name, count in counts.items()) if label is None else label
            raise ConfigError(
                f"label: expected a class that the detector knows, one of {', '.join(detected)}; got {names}. "
                + _advice(counts, detected, label)
            )
        if label is None:
            return
        if counts and label not in counts:
            guess = closest_class(label, counts)
            shown = ", ".join(f"{name} ({count})" for name, count in counts.items())
            raise ConfigError(
                f"label: expected an annotated class, one of {shown}; got {label!r}"
                + (f". Did you mean {guess}?" if guess else "")
            )

    def _counted_label(self, result: Result) -> str:
        """The class that was scored, and which annotated classes counted as it: "vehicle with large_vehicle"."""
        annotated = {name for boxes in self.annotated.values() for name in np.unique(boxes.label).tolist()}
        relabel = result.settings.get("relabel") or {}
        others = sorted(name for name, other in relabel.items() if other == result.label and name in annotated)
        return f"{result.label} with {' and '.join(others)}" if others else result.label

    def evaluated(self, protocol: Protocol, settings: Any) -> Result:
        """Evaluate detections that count (see :meth:`counted`) with the settings of a protocol."""
        check_numbers(settings)
        result = without_lone_intervals(protocol.evaluate(self, settings))
        if self.facts.get("ranges") == "not known":
            result = without_ranges(result)
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
        boxes, annotations = alike(self.boxes), alike(self.annotations)
        details: dict[Key, Details] = {}
        outside = OutsideCounts()
        for key, annotation in self.annotations.items():
            predicted, rows = self.boxes.get(key, _NO_BOXES), self.prediction_details.get(key)
            check_crowd(f"frame {key}", max(len(predicted), len(annotation.boxes)))
            if annotation.region is not None:
                predicted_in = inside_field(predicted, annotation.region)
                annotated_in = inside_field(annotation.boxes, annotation.region)
                outside.add(annotation.region, predicted_in, annotated_in)
                predicted = predicted if predicted_in.all() else predicted[predicted_in]
                annotation = annotation if annotated_in.all() else annotation[annotated_in]
                rows = None if rows is None else {name: np.asarray(v)[predicted_in] for name, v in rows.items()}
            boxes[key], annotations[key] = predicted, annotation
            if rows is not None:
                details[key] = rows
        return replace(
            self,
            boxes=boxes,
            annotations=annotations,
            prediction_details=details,
            conditions={key: self.conditions[key] for key in annotations if key in self.conditions},
            notes=(*notes, *outside.notes()),
        )


_NO_BOXES = Boxes.empty(scored=True)


def _advice(counts: Mapping[str, int], detected: Mapping[str, None], label: str | None) -> str:
    """What to do where a class is requested that the detector does not know, or where annotated ones are none of its.

    Args:
        counts: Annotated boxes by class.
        detected: The detector's classes.
        label: The requested class, if one was.
    """
    shared = [name for name in counts if name in detected]
    if label is not None and label not in counts and shared:
        return f"Take an annotated one: --label {' or '.join(shared)}"
    guess = next((f"{name}:{meant}" for name in counts if (meant := closest_class(name, detected))), "")
    guess = guess or f"{label if label in counts else next(iter(counts))}:{next(iter(detected))}"
    return f"Name what is meant with --options relabel={guess} (relabel=, a mapping, in Python)"


def _within_reach(result: Result, reach_m: float | None) -> Result:
    """A result whose range bins beyond the detector's reach are null, with notes that say so."""
    if reach_m is None:
        return result
    edges_m = [float(edge) for edge in result.settings.get("range_bins_m") or ()]
    bins_m = {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(edges_m)}
    scored = [name for name in bins_m if any(v is not None for v in result.ranges.get(name, {}).values())]
    beyond = [name for name in scored if bins_m[name][0] >= reach_m]
    partly = [name for name in scored if bins_m[name][0] < reach_m < bins_m[name][1]]
    notes = list(result.notes)
    if beyond:
        notes.append(f"range {', '.join(beyond)} m begins beyond the detector's reach of {reach_m:g} m: not scored")
    if partly:
        notes.append(f"range {', '.join(partly)} m ends beyond the detector's reach of {reach_m:g} m")
    return replace(result.without(beyond), notes=tuple(notes))
