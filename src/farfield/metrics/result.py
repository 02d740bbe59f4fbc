"""The result of a score: figures, intervals and curves, which print themselves with their convention."""

import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from farfield.metrics.bootstrap import Statistics
from farfield.metrics.subject import Subject
from farfield.registry import display_html

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
    convention: str
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
        return f"{type(self).__name__}({about}; {len(self.figures)} figures)"

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
        bootstrap = self.settings.get("bootstrap", {})
        drawn = f"[low, high]: {bootstrap.get('level', 0.95):.0%} bootstrap interval over {self.grouped_by}"
        drawn += " (there is only one sequence)" if self.grouped_by == "frames" else ""
        none = not any(interval for part in self.intervals.values() for interval in part.values())
        lines = [f"{self.protocol}: {self.convention}", "no bootstrap intervals" if none else drawn]
        lines += [f"note: {note}" for note in self.notes]
        lines = lines if self.subject is None else [f"of: {self.subject}", *lines]
        return "\n".join(textwrap.fill(line, 116, subsequent_indent="  ", break_on_hyphens=False) for line in lines)


def nest(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Turn ``{"dds/0/map": 1}`` into ``{"dds": {"0": {"map": 1}}}``."""
    tree: dict[str, Any] = {}
    for name, value in flat.items():
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
