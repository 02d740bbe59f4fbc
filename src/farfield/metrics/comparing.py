"""Results side by side: read from files, set into tables, never two conventions in one column."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.errors import ConfigError
from farfield.files.json_text import read_json
from farfield.metrics.detections import Protocol, protocol_of
from farfield.metrics.result import Subject, at, figure_names, subject_of, table, value_at
from farfield.metrics.result_json import check_parts, check_result
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.counts import count_of

Tree = Mapping[str, Any]
_EVALUATION = "evaluation.json"
_HOMES = {"range": ("ranges",), "visibility": ("visibility",)}  # others: conditions


@dataclass(frozen=True)
class ComparedResult:
    """One result of one class.

    Args:
        name: What its row is called.
        family: The protocol without its variant.
        label: The class.
        tree: Result JSON.
        protocol: The protocol.
        subject: What it is of; None for a result from before results said so.
    """

    name: str
    family: str
    label: str
    tree: Tree
    protocol: Protocol
    subject: Subject | None = None

    def same_data(self, other: "ComparedResult") -> bool:
        """Whether both are of the same data: by fingerprints where both have any, else by the numbers of boxes."""
        a, b = self.subject, other.subject
        if a is not None and b is not None and a.labels_fingerprint and b.labels_fingerprint:
            return a.same_data(b)
        return _data(self) == _data(other)


@dataclass(frozen=True)
class Column:
    """One figure of one part of the results: ``("ranges", "0-70")``, ``("conditions", "weather", "fog")`` or ``()``."""

    title: str
    figure: str
    part: tuple[str, ...] = ()


def compare(
    entries: Sequence[ComparedResult],
    *,
    label: str | None = None,
    figures: Sequence[str] = (),
    by: str = "none",
    separate: bool = False,
) -> str:
    """Tables of results with their conventions and subjects, a row a result, a table a protocol and class.

    Results of different data have columns of their own, as conventions have that are kept apart.

    Args:
        entries: The results, see :func:`read_results`.
        label: The class; None for all.
        figures: Names of figures; none for those that stand for a result.
        by: ``"none"``: the figures of the whole; ``"range"``, ``"visibility"``, ``"weather"``, ``"road"``, ``"time"``,
            ``"azimuth"``: the parts, a table a figure.
        separate: Give each convention columns of its own instead of refusing to compare.

    Raises:
        ConfigError: If results of one table differ in their convention, or a label, figure or part is in none of them.
    """
    groups = dict.fromkeys((entry.family, entry.label) for entry in entries if label in (None, entry.label))
    if not groups:
        present = ", ".join(dict.fromkeys(entry.label for entry in entries))
        raise ConfigError(f"label: expected one of {present}; got {label!r}")
    tables: list[str] = []
    for group in groups:
        members = [entry for entry in entries if (entry.family, entry.label) == group]
        tables += _tables(members, figures=figures, by=by, separate=separate)
    return "\n\n".join(tables)


def read_results(paths: Sequence[Path], names: Sequence[str] = ()) -> list[ComparedResult]:
    """Read result files: what ``farfield score --json`` and ``farfield evaluate`` write.

    Args:
        paths: JSON files, or folders of ``farfield evaluate``.
        names: What to call the results; unless given, an evaluation's by its detector, data and cloud, others by their
            files.

    Raises:
        ConfigError: If there is no such file, or there are not as many names as results.
        FileFormatError: If a file holds no result.
    """
    trees_by_name: list[tuple[str, Tree]] = []
    for path in paths:
        path = path / _EVALUATION if path.is_dir() else path
        trees = _read(path)
        trees_by_name += [(_called(path, name, tree, alone=len(trees) == 1), tree) for name, tree in trees.items()]
    called = list(names) or [name for name, _ in trees_by_name]
    if not trees_by_name or len(called) != len(trees_by_name) or not all(called):
        raise ConfigError(
            f"expected one or more results and as many names, got {len(trees_by_name)} and {', '.join(names)!r}"
        )
    if len(set(called)) < len(called):
        called = [f"{number}: {name}" for number, name in enumerate(called, 1)]
    entries = []
    for name, (_, tree) in zip(called, trees_by_name, strict=True):
        family, protocol = protocol_family(tree), protocol_of(tree)
        if protocol.several_classes:
            classes = dict.fromkeys(protocol.compared(tree), tree)
        else:
            classes = tree.get("labels") or {tree.get("label", ""): tree}
        entries += [
            ComparedResult(
                name, family, str(label), class_result, protocol, subject_of(class_result) or subject_of(tree)
            )
            for label, class_result in classes.items()
        ]
    return entries


def _called(path: Path, name: str, tree: Tree, *, alone: bool) -> str:
    """What a result is called: an evaluation by its subject or else its folder, others by their file."""
    subject = subject_of(tree)
    if path.name == _EVALUATION and subject is not None and subject.detector:
        return subject.name
    stem = path.resolve().parent.name if path.name == _EVALUATION and path.resolve().parent.name else path.stem
    return stem if alone else f"{stem}: {name}"


def _read(path: Path) -> dict[str, Tree]:
    """Results of a file: one of ``farfield score``, or those of each cloud of ``farfield evaluate``."""
    if not path.is_file():
        raise ConfigError(f"{path}: expected a JSON file of results, found none there")
    tree = read_json(path)
    inner = tree.get("results") if isinstance(tree, dict) else None
    results = inner if isinstance(inner, dict) and "protocol" not in tree else {"": tree}
    if isinstance(tree, dict) and results is inner:
        check_parts(tree, path)
        for name, beside in (tree.get("parts") or {}).items():
            if isinstance(results.get(name), dict) and "conditions" in beside:
                results[name] = {"conditions": beside["conditions"], **results[name]}
    for name, result in results.items():
        check_result(result, path, ("results", name) if results is inner else ())
    return results


def _tables(members: list[ComparedResult], *, figures: Sequence[str], by: str, separate: bool) -> list[str]:
    """Tables of one protocol and class, then their conventions and what is to be known of the data."""
    conventions = _conventions(members, by_range=by == "range", separate=separate)
    letters = {entry.name: letter for entry, letter in zip(members, conventions, strict=True)}
    tables = [
        f"{members[0].family}, {members[0].label}{title}{_unit(members[0])}; '-': nothing annotated\n\n"
        + _layout(members, columns, letters)
        for title, columns in _columns(members, figures, by)
    ]
    return [*tables, _footer(members, letters, by_range=by == "range")]


def _layout(members: list[ComparedResult], columns: list[Column], letters: Mapping[str, str]) -> str:
    """The table; where there are several conventions, each figure has a column for each of them."""
    kinds = list(dict.fromkeys(letters.values()))
    head = [column.title + (f" [{kind}]" if len(kinds) > 1 else "") for column in columns for kind in kinds]
    rows = []
    for entry in members:
        mine = letters[entry.name]
        cells = [_cell(entry, column) if kind == mine else "" for column in columns for kind in kinds]
        rows.append([entry.name, *cells])
        spans = [_span(entry, column) if kind == mine else "" for column in columns for kind in kinds]
        rows += [[f"  {_level(entry):.0%} interval", *spans]] if any(spans) else []
    return table(["", *head], rows)


def _level(entry: ComparedResult) -> float:
    """How much of the drawn scores an interval holds."""
    level = at(entry.tree.get("settings"), ("bootstrap", "level"))
    return float(level) if isinstance(level, float | int) else 0.95


def _span(entry: ComparedResult, column: Column) -> str:
    """The interval of a figure of the whole; empty where the result has none."""
    span = None if column.part else at(entry.tree.get("intervals"), ("overall", *column.figure.split("/")))
    if not isinstance(span, list) or len(span) != 2 or None in span:
        return ""
    return "-".join(f"{100 * bound:.1f}" if _unit(entry) else f"{bound:.3f}" for bound in span)


def _cell(entry: ComparedResult, column: Column) -> str:
    value = value_at(at(entry.tree, column.part), column.figure)
    if value is None:
        return "-"
    return f"{100 * value:.2f}" if _unit(entry) else f"{value:.4f}"


def _spans_of(entry: ComparedResult) -> list[str]:
    """The intervals of the main figures."""
    return [_span(entry, Column("", figure)) for figure in entry.protocol.presenter.presentation(entry.tree).figures]


def _unit(entry: ComparedResult) -> str:
    return ", per cent" if entry.protocol.presenter.per_cent else ""


def _footer(members: list[ComparedResult], letters: Mapping[str, str], *, by_range: bool) -> str:
    firsts: dict[str, ComparedResult] = {}
    for entry in members:
        firsts.setdefault(letters[entry.name], entry)
    lines = []
    for letter, entry in firsts.items():
        mark = f"[{letter}] " if len(firsts) > 1 else ""
        lines.append(mark + convention_text(entry.tree, by_range=by_range))
    if not by_range and any(any(_spans_of(entry)) for entry in members):
        lines.append("intervals are of each row alone: of rows on the same frames, overlapping ones do not decide")
    lines += [f"row {entry.name}: {entry.subject}" for entry in members if entry.subject is not None]
    if not all(entry.same_data(members[0]) for entry in members):
        data = {entry.name: _data(entry) for entry in members}
        counts = "; ".join(
            f"{name}: {count_of(frames, 'frame')}, {boxes} annotated" for name, (frames, boxes) in data.items()
        )
        alike = len(set(data.values())) == 1
        why = ". Their files, the options with which they were read, or their labels differ" if alike else ""
        lines.append(f"note: not the same data. {counts}{why}")
    wrapped = (textwrap.fill(line, 116, subsequent_indent="  ", break_on_hyphens=False) for line in lines)
    return "\n".join(wrapped)


def _data(entry: ComparedResult) -> tuple[Any, Any]:
    counts = entry.tree.get("counts") or {}
    mine = at(counts, ("classes", entry.label)) or counts
    frames = counts.get("frames_given", counts.get("frames"))  # tracking's protocols count all frames alike
    if frames is None and entry.subject is not None:
        frames = entry.subject.frames
    return frames, mine.get("annotated")


def _conventions(members: list[ComparedResult], *, by_range: bool, separate: bool) -> list[str]:
    """A letter for the data and the convention of each result.

    Different data always stand apart; different conventions may, or are refused.
    """
    firsts: list[ComparedResult] = []
    letters = []
    for entry in members:
        same = [
            first.same_data(entry) and not differing_settings(first.tree, entry.tree, by_range=by_range)
            for first in firsts
        ]
        if not any(same):
            if firsts and not separate:
                _check_convention(firsts[0], entry, by_range=by_range)
            firsts.append(entry)
            same.append(True)
        letters.append(chr(ord("A") + same.index(True)) if same.index(True) < 26 else f"Z{same.index(True)}")
    return letters


def _check_convention(first: ComparedResult, entry: ComparedResult, *, by_range: bool) -> None:
    differing = differing_settings(first.tree, entry.tree, by_range=by_range)
    if differing:
        differences = "; ".join(f"{name}: {a} and {b}" for name, (a, b) in differing.items())
        raise ConfigError(
            f"{first.name} and {entry.name} were scored by different conventions ({differences}), so their "
            "numbers do not belong in one column. Score them alike, or keep them apart (--separate)"
        )


def _columns(members: list[ComparedResult], figures: Sequence[str], by: str) -> list[tuple[str, list[Column]]]:
    """Title and columns of each table."""
    trees, protocol = [entry.tree for entry in members], members[0].protocol
    prefix = f"ap/{members[0].label}/" if protocol.several_classes else ""
    names = [name if name.startswith(prefix) else prefix + name for name in figures] or _usual(members, prefix, by)
    for name in names:
        if not any(name.split("/")[-1] in _node(tree, name) for tree in trees):
            present = [leaf.removeprefix(prefix) for tree in trees for leaf in _figures_of(tree, prefix)]
            raise ConfigError(f"figures: expected some of {', '.join(dict.fromkeys(present))}; got {name!r}")
    titles = {name: protocol.presenter.title(name.removeprefix(prefix)) for name in names}
    if by == "none":
        return [("", [Column(title, name) for name, title in titles.items()])]
    return [(f", {title}", [Column("total", name), *_part_columns(trees, name, by)]) for name, title in titles.items()]


def _part_columns(trees: list[Tree], figure: str, by: str) -> list[Column]:
    home = _HOMES.get(by, ("conditions", by))
    present: list[str] = list(CONDITIONS.get(by, ()))
    for tree in trees:
        node = at(tree, home)
        present += [name for name in (node if isinstance(node, dict) else {}) if name not in present]
    if not any(at(tree, home) for tree in trees):
        raise ConfigError(f"by {by}: none of the results has figures by {by}; see farfield score --help")
    return [Column(name.replace("_", " "), figure, (*home, name)) for name in present]


def _usual(members: list[ComparedResult], prefix: str, by: str) -> list[str]:
    """Figures that are shown if none are named: the protocol's headline; of parts the first of it alone."""
    named = (name for entry in members for name in entry.protocol.headline(entry.tree) if name.startswith(prefix))
    shown = list(dict.fromkeys(named)) or _figures_of(members[0].tree, prefix)
    return shown[: 1 if by != "none" else None]


def _figures_of(tree: Tree, prefix: str) -> list[str]:
    """Names of all figures, of several classes those of one."""
    return [name for name in figure_names(tree) if name.startswith(prefix)]


def _node(tree: Tree, figure: str) -> Mapping[str, Any]:
    node = at(tree, figure.split("/")[:-1])
    return node if isinstance(node, Mapping) else {}


# Conventions: results stand in one column if their settings agree in all that their figures depend on.


def protocol_family(result: Tree) -> str:
    """The protocol without its variant: figures of two families never share a column.

    >>> protocol_family({"protocol": "kradar-compat:old_as_shipped"})
    'kradar'
    """
    protocol = protocol_of(result)
    return protocol.family or str(protocol)


def convention_of(result: Tree, *, by_range: bool = False) -> dict[str, Any]:
    """The settings on which a result's figures depend, by its protocol.

    Args:
        result: Result JSON, as ``farfield score --json`` writes it.
        by_range: Whether figures of range bins are looked at, so that the bins matter.
    """
    return protocol_of(result).depends_on(result.get("settings") or {}, by_range=by_range)


def differing_settings(a: Tree, b: Tree, *, by_range: bool = False) -> dict[str, tuple[Any, Any]]:
    """Settings in which two results' conventions differ, with both values; None where one lacks the setting."""
    here, there = convention_of(a, by_range=by_range), convention_of(b, by_range=by_range)
    names = [*here, *(name for name in there if name not in here)]
    return {name: (here.get(name), there.get(name)) for name in names if here.get(name) != there.get(name)}


def convention_text(result: Tree, *, by_range: bool = False) -> str:
    """The convention as one line of ``name=value`` pairs, in the order in which its protocol prints them."""
    settings = result.get("settings") or {}
    return f"{result.get('protocol')}: " + protocol_of(result).convention_text(settings, by_range=by_range)
