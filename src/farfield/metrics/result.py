"""The result of a score: figures, intervals and curves, which print themselves with their convention; and its subject.

A :class:`Subject` says what a figure is about: who detected what in which data, and how that was counted.
"""

import hashlib
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from farfield.files.tables import table_of
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Statistics
from farfield.metrics.frames import frame_order
from farfield.registry import display_html
from farfield.vocabulary.counts import count_of

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
        objects = "objects not counted" if self.annotated is None else f"{count_of(self.annotated, 'object', spec=',')}"
        frames = "" if self.frames is None else f" in {count_of(self.frames, 'frame', spec=',')}"
        training = f"seen in training: {self.seen_in_training}"
        parts = [f"{who} on {what}", self.cloud and f"cloud {self.cloud}", self.label.replace("_", " ")]
        return "; ".join([*filter(None, parts), objects + frames, f"region {self.region}", self.protocol, training])

    def to_json(self) -> dict[str, Any]:
        """The same as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, tree: Any) -> "Subject | None":
        """What :meth:`to_json` gave; None where a result, such as an older one, has no subject."""
        if not isinstance(tree, Mapping) or not all(isinstance(tree.get(name), str) for name in ("protocol", "label")):
            return None
        values: dict[str, Any] = {entry.name: tree[entry.name] for entry in fields(cls) if entry.name in tree}
        numbers = {"annotated", "frames"}
        good = {
            name: value
            for name, value in values.items()
            if (isinstance(value, int) if name in numbers else isinstance(value, str)) and not isinstance(value, bool)
        }
        return cls(**good)

    def same_data(self, other: "Subject") -> bool:
        """Whether both are of the same files and annotations, as far as both say."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("fingerprint", "labels_fingerprint")]
        return all(
            own_digest == other_digest or not own_digest or not other_digest for own_digest, other_digest in pairs
        )


def _mark(digest: str) -> str:
    return f" [{digest[:_SHOWN]}]" if digest else ""


def subject_of(result: Mapping[str, Any]) -> Subject | None:
    """The subject of a result's JSON; None for one that was written before results had any."""
    return Subject.from_json(result.get("subject"))


def labels_fingerprint(annotations: Mapping[Key, Annotation]) -> str:
    """SHA-256 over the annotated boxes: frames, classes, and places, sizes and headings to a millimetre or milliradian.

    The order of a frame's boxes does not bear on it. Unlike the fingerprint of a data set it does not depend on
    files: labels that were moved without a change of a file's size differ in it.
    """
    return digest_of((key, annotations[key]) for key in sorted(annotations, key=frame_order))


def digest_of(annotations: Iterable[tuple[Key, Annotation]]) -> str:
    """SHA-256 over annotations one after the other, see :func:`labels_fingerprint`."""
    digest = hashlib.sha256()
    for key, annotation in annotations:
        boxes = annotation.boxes
        rows = np.rint(np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]) * 1e3).astype(np.int64)
        order = np.lexsort((np.unique(boxes.label, return_inverse=True)[1].reshape(-1), *rows.T))
        digest.update("\0".join((*key, *np.asarray(boxes.label)[order].tolist())).encode() + b"\n")
        digest.update(rows[order].tobytes())
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


Intervals = Mapping[str, list[float] | None]
R = TypeVar("R", bound="Result")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Result:
    """What every protocol returns.

    Args:
        protocol: Name of the protocol, with its variant.
        label: The class that was scored, or the classes.
        settings: Every option, as JSON values.
        convention: The options in one line.
        figures: The scores of the whole region by name, such as ``"dds/0.003/map"``; None where nothing is annotated.
        ranges: The same for each range bin, named such as ``"0-70"``.
        mean_of_bins: Mean of the bins' scores.
        counts: Boxes and frames that were counted.
        intervals: Bootstrap [low, high] by part (``"overall"``, a bin, ``"mean_of_bins"``) and name.
        grouped_by: What the bootstrap drew: ``"sequences"`` or ``"frames"``.
        curves: Raw curves with ``recall``, ``precision`` and ``confidence``: by part, epsilon and threshold, or, for
            KITTI, by part, measure and difficulty.
        notes: What was assumed or left out, one sentence each.
        subject: What the figures are of; None for a result that was not made of :class:`Detections`.
    """

    protocol: str
    label: str
    settings: Mapping[str, Any]
    convention: str = ""
    figures: Statistics
    ranges: Mapping[str, Statistics] = field(default_factory=dict)
    mean_of_bins: Statistics = field(default_factory=dict)
    counts: Mapping[str, Any] = field(default_factory=dict)
    intervals: Mapping[str, Intervals] = field(default_factory=dict)
    grouped_by: str = "sequences"
    curves: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    subject: Subject | None = None

    def __repr__(self) -> str:
        """What it is of, and its first figure."""
        about = f"{self.protocol} of {self.label!r}" if self.subject is None else str(self.subject)
        return f"{type(self).__name__}({about}; {count_of(len(self.figures), 'figure')})"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the table, and the curves."""
        return display_html("result", self)

    def __str__(self) -> str:
        rows = [[name, *(self.cell(part, name) for part in ("overall", *self.ranges))] for name in self.figures]
        return f"{self.protocol} of {self.label!r}\n\n{table(['', 'overall', *self.ranges], rows)}\n\n{self.footer()}"

    @property
    def known(self) -> bool:
        """Whether anything could be scored: one figure at least is not None."""
        return any(figure is not None for figure in self.figures.values())

    def without(self: R, ranges: Collection[str]) -> R:
        """The result with no figure for these range bins."""
        if not ranges:
            return self
        blank = {name: dict.fromkeys(self.ranges[name]) for name in ranges}
        return replace(
            self,
            ranges={**self.ranges, **blank},
            intervals={**self.intervals, **{name: blank[name] for name in ranges if name in self.intervals}},
            curves={**self.curves, **{name: None for name in ranges if name in self.curves}},
        )

    def columns(self) -> dict[str, list[Any]]:
        """The figures as columns: ``figure``, ``part`` (``overall`` or a range bin), ``value``, ``low``, ``high``."""
        rows = [
            (name, part, value, *((self.intervals.get(part) or {}).get(name) or (None, None)))
            for part, figures in {"overall": self.figures, **self.ranges}.items()
            for name, value in figures.items()
        ]
        names = ("figure", "part", "value", "low", "high")
        return {name: [row[number] for row in rows] for number, name in enumerate(names)}

    def to_pandas(self) -> Any:
        """The figures as a DataFrame, a row a figure and part, with their 95 % intervals where there are any.

        Raises:
            ConfigError: If pandas is not installed.
        """
        return table_of(self.columns(), "pandas", "Result.to_pandas")

    def to_polars(self) -> Any:
        """The same as a DataFrame of polars; errors are those of :meth:`to_pandas`."""
        return table_of(self.columns(), "polars", "Result.to_polars")

    def to_json(self) -> dict[str, Any]:
        """The result as JSON values at full precision: curves are given at 101 recalls; null is "not annotated".

        The key ``notes`` is there if there are any.
        """
        top = {"ap": {}, "errors": {}, "dds": {}} | nest(self.figures)
        empty = {name for name, part in self.ranges.items() if all(value is None for value in part.values())}
        return {
            "protocol": self.protocol,
            "label": self.label,
            **({} if self.subject is None else {"subject": self.subject.to_json()}),
            "settings": dict(self.settings),
            **top,
            "ranges": {name: None if name in empty else nest(part) for name, part in self.ranges.items()},
            "mean_of_bins": nest(self.mean_of_bins),
            "counts": dict(self.counts),
            "intervals": {"resampled": self.grouped_by} | {name: nest(part) for name, part in self.intervals.items()},
            "curves": _curves_json(self.curves),
            **({"notes": list(self.notes)} if self.notes else {}),
        }

    def cell(self, part: str, name: str, *, scale: float = 1.0) -> str:
        """One figure with its interval as text, such as ``"0.8359 [0.8211, 0.8502]"``; 100 as scale shows per cent."""
        figures = {"overall": self.figures, "mean_of_bins": self.mean_of_bins, **self.ranges}[part]
        value, interval = figures.get(name), self.intervals.get(part, {}).get(name)
        if value is None:
            return "-"
        digits = 4 if scale == 1 else 2
        text = [f"{scale * number:.{digits}f}" for number in [value, *(interval or [])]]
        return f"{text[0]} [{text[1]}, {text[2]}]" if interval else text[0]

    def footer(self) -> str:
        """The convention, what the intervals are, and the notes, wrapped."""
        return _wrapped(self.footer_lines())

    def footer_lines(self) -> list[str]:
        """What the figures are of, the convention, what the intervals are, and the notes: a line each."""
        bootstrap = self.settings.get("bootstrap", {})
        drawn = f"[low, high]: {bootstrap.get('level', 0.95):.0%} bootstrap interval over {self.grouped_by}"
        drawn += " (there is only one sequence)" if self.grouped_by == "frames" else ""
        none = not any(interval for part in self.intervals.values() for interval in part.values())
        lines = [f"{self.protocol}: {self.convention}", "no bootstrap intervals" if none else drawn]
        lines += [f"note: {note}" for note in self.notes]
        return lines if self.subject is None else [f"of: {self.subject}", *lines]


def tables_of(results: Sequence[Result]) -> str:
    """Several results one after another; what all say of convention and intervals stands once, below the last."""
    shared = set.intersection(*(set(result.footer_lines()) for result in results)) if results else set()
    texts = []
    for result in results[:-1]:
        own = [line for line in result.footer_lines() if line not in shared]
        texts.append((str(result).removesuffix(result.footer()) + _wrapped(own)).rstrip("\n"))
    return "\n\n".join([*texts, *map(str, results[-1:])])


def _wrapped(lines: Sequence[str]) -> str:
    return "\n".join(textwrap.fill(line, 116, subsequent_indent="  ", break_on_hyphens=False) for line in lines)


def without_lone_intervals(result: R) -> R:
    """The result without intervals of parts in which one object is annotated: no drawing varies it, found or not."""
    ranges = result.counts.get("ranges") or {}
    counted = {"overall": result.counts, **(ranges if isinstance(ranges, Mapping) else {})}
    lone = [part for part, counts in counted.items() if _annotated(counts) == 1 and any(_spans(result, part))]
    if not lone:
        return result
    lone += ["mean_of_bins"] if "overall" in lone and "mean_of_bins" in result.intervals else []
    blank = {part: dict.fromkeys(result.intervals[part]) for part in lone}
    where = ", ".join("the whole" if part == "overall" else f"{part} m" for part in lone if part != "mean_of_bins")
    note = f"no intervals of {where}: there is one annotated object, and a figure of one object is no average"
    return replace(result, intervals={**result.intervals, **blank}, notes=(*result.notes, note))


def without_ranges(result: R) -> R:
    """The result of boxes that stand in the world, at no known distance from a sensor."""
    note = (
        "the boxes stand in the coordinates of the world, so nothing says how far they are from the sensor: there are "
        "no figures by range. Give ego_translation beside translation in one of the files, or boxes in a sensor's "
        "coordinates"
    )
    blank = result.without(list(result.ranges))
    return replace(blank, mean_of_bins=dict.fromkeys(blank.mean_of_bins), notes=(*result.notes, note))


def _annotated(counts: Any) -> int | None:
    """Annotated boxes of a part, of all of its classes or difficulties together."""
    value = counts.get("annotated") if isinstance(counts, Mapping) else None
    return value if isinstance(value, int) else max(value.values(), default=0) if isinstance(value, Mapping) else None


def _spans(result: Result, part: str) -> list[list[float]]:
    return [span for span in result.intervals.get(part, {}).values() if span]


def nest(named: Mapping[str, Any]) -> dict[str, Any]:
    """Turn ``{"dds/0/map": 1}`` into ``{"dds": {"0": {"map": 1}}}``."""
    tree: dict[str, Any] = {}
    for name, value in named.items():
        *path, leaf = name.split("/")
        node = tree
        for step in path:
            node = node.setdefault(step, {})
        node[leaf] = value
    return tree


def at(tree: Any, path: Sequence[str]) -> Any:
    """What stands in a tree at a path; None where there is nothing."""
    for step in path:
        if not isinstance(tree, Mapping) or step not in tree:
            return None
        tree = tree[step]
    return tree


def value_at(tree: Any, name: str) -> float | None:
    """The figure of a name such as ``"dds/0/map"``; None where there is none."""
    value = at(tree, name.split("/"))
    return float(value) if isinstance(value, float | int) and not isinstance(value, bool) else None


def leaves(node: Any, path: str) -> Iterator[str]:
    """Names of all leaves of a tree that stands at a path."""
    if isinstance(node, Mapping):
        for name, inner in node.items():
            yield from leaves(inner, f"{path}/{name}" if path else str(name))
    else:
        yield path


_BESIDE = frozenset(
    [
        "protocol",
        "label",
        "subject",
        "settings",
        "ranges",
        "mean_of_bins",
        "counts",
        "intervals",
        "curves",
        "classes",
        "conditions",
        "visibility",
        "labels",
        "notes",
    ]
)


def figure_names(result: Mapping[str, Any]) -> list[str]:
    """Names of all figures of the whole in a result's JSON, or of a part of it."""
    return [name for part, inner in result.items() if part not in _BESIDE for name in leaves(inner, str(part))]


def table(head: list[str], rows: list[list[str]]) -> str:
    """Lay out text cells in columns: the first to the left, the others to the right."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    lines = [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        )
        for row in [head, ["-" * width for width in widths], *rows]
    ]
    return "\n".join(line.rstrip() for line in lines)


def _curves_json(curves: Any) -> Any:
    if isinstance(curves, Mapping):
        return {name: _curves_json(inner) for name, inner in curves.items()}
    return None if curves is None else curves.sampled()
