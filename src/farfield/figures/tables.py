"""Tables of results as rows of plain values: by range, by condition and class, and as K-Radar's Table 4."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from farfield.errors import ConfigError
from farfield.evaluation.report_data import counts, figure, interval, part_names
from farfield.metrics.comparing import convention_text, differing_settings, protocol_family
from farfield.metrics.detections import Protocol, presentation_of, protocol_of
from farfield.metrics.result import at, table, value_at
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.published_tables import KRADAR_TABLES

Results = Mapping[str, Mapping[str, Any]]
NOTHING = "–"


@dataclass(frozen=True)
class TableCell:
    """One figure of a table.

    Args:
        value: The figure, or None where nothing is annotated.
        interval: Bootstrap interval, or None.
        unit: In which it is shown: ``"%"`` is in per cent, and an empty one a share.
    """

    value: float | None
    interval: tuple[float, float] | None = None
    unit: str = ""

    @property
    def text(self) -> str:
        """The figure to three decimals, in per cent to two, or a dash."""
        return NOTHING if self.value is None else figure_text(self.value, self.unit)

    @property
    def interval_text(self) -> str:
        """The interval with a decimal less, or nothing."""
        if self.interval is None:
            return ""
        return " to ".join(figure_text(end, self.unit, less=1) for end in self.interval)

    @property
    def percent(self) -> float:
        """The figure as a bar's length, 0 to 100."""
        return 0.0 if self.value is None else round(100 * min(max(self.value, 0.0), 1.0), 1)


def figure_text(value: float, unit: str, *, less: int = 0) -> str:
    """A figure as text without its unit; ``less`` decimals less than usual."""
    return f"{100 * value:.{2 - less}f}" if unit == "%" else f"{value:.{3 - less}f}"


@dataclass(frozen=True)
class ScoreTableRow:
    """Scores of one result in one range.

    Args:
        result: Name of the result.
        part: ``"overall"`` or the bin's name.
        annotated: Number of annotated boxes, or None where unknown.
        predicted: Number of predictions, or None.
        cells: Figures by name.
    """

    result: str
    part: str
    annotated: int | None
    predicted: int | None
    cells: Mapping[str, TableCell] = field(default_factory=dict)


def range_name(part: str) -> str:
    """A bin's name as people read it: ``"0-70"`` becomes ``"0 to 70 m"``."""
    return "all ranges" if part == "overall" else " to ".join(part.split("-")) + " m"


def heading(protocol: Protocol, name: str) -> str:
    """Head of a figure's column: its title and its unit."""
    unit = protocol.presenter.unit(name)
    return protocol.presenter.title(name) + (f" ({unit})" if unit else "")


def rows(results: Results, names: Sequence[str], protocol: Protocol) -> list[ScoreTableRow]:
    """Rows by range, near to far and then overall, and inside a range by result.

    Args:
        results: Result JSON by name.
        names: Figures to take, such as ``"dds/0/dds"`` or ``"ap/2.0"``.
        protocol: Says in which units they are shown.
    """
    parts: list[str] = []
    for result in results.values():
        parts += [part for part in part_names(result) if part not in parts]
    parts.sort(key=lambda part: float(part.split("-")[0]))
    ordered = [*parts, "overall"]
    return [_score_row(name, result, part, names, protocol) for part in ordered for name, result in results.items()]


def _score_row(
    name: str, result: Mapping[str, Any], part: str, names: Sequence[str], protocol: Protocol
) -> ScoreTableRow:
    number = counts(result, part=part)
    cells = {
        figure_name: TableCell(
            figure(result, figure_name, part=part),
            interval(result, figure_name, part=part),
            protocol.presenter.unit(figure_name),
        )
        for figure_name in names
    }
    return ScoreTableRow(name, part, number.get("annotated"), number.get("predictions"), cells)


# Tables of an evaluation's parts, for the page: scores by condition and sector, and a row for each class.

Parts = Mapping[str, Mapping[str, Any]]
_HEADS = {
    "weather": ("By weather", "weather"),
    "road": ("By road", "road"),
    "time": ("By time of day", "time"),
    "azimuth": ("By direction", "degrees from ahead"),
    "visibility": ("By visibility", "seen by"),
}
_SEEN_BY = {"R": "the radar", "L": "the LiDAR alone", "L1": "not known"}


@dataclass(frozen=True)
class PartRow:
    """Figures of one part, or of one class, in one result.

    Args:
        title: What the part or class is called.
        result: Name of the result.
        first: Whether it is the first row of its title.
        cells: Figures by name.
        annotated: Annotated boxes, None where not known.
        frames: Frames with boxes, None where not known.
        why: Why there is no figure; empty where there is one.
    """

    title: str
    result: str
    first: bool
    cells: Mapping[str, TableCell]
    annotated: int | None = None
    frames: int | None = None
    why: str = ""


def with_own_parts(results: Parts, parts: Parts) -> dict[str, dict[str, Any]]:
    """The parts of each result, where a result has some itself (K-Radar's by weather) those before what was added.

    Args:
        results: Result JSON by name.
        parts: What was added, by result name.
    """
    merged = {}
    for name, result in results.items():
        tree = {key: dict(parts.get(name, {}).get(key) or {}) for key in ("conditions", "counts", "intervals")}
        tree["conditions"] |= result.get("conditions") or {}
        tree["conditions"] |= {"visibility": result["visibility"]} if result.get("visibility") else {}
        counts = result.get("counts") or {}
        tree["counts"] |= counts.get("conditions") or {}
        tree["counts"] |= {"visibility": counts["visibility"]} if counts.get("visibility") else {}
        tree["intervals"] |= {
            part: interval for part, interval in (result.get("intervals") or {}).items() if "/" in part
        }
        merged[name] = tree
    return merged


def condition_tables(
    parts: Parts, names: Sequence[str], protocol: Protocol, kinds: Sequence[str] = tuple(_HEADS)
) -> list[tuple[str, str, list[PartRow]]]:
    """Title, head and rows of a table for each kind of part of which there is a value.

    Args:
        parts: By result name, see :func:`with_own_parts`.
        names: Figures to take, such as ``"dds/0/dds"``.
        protocol: Says in which units they are shown.
        kinds: Which kinds, in which order.
    """
    tables = []
    for kind in (kind for kind in kinds if kind in _HEADS):
        title, head = _HEADS[kind]
        values = [
            value
            for value in _names(parts, ("conditions", kind))
            if any(at(part, ("counts", kind, value, "frames")) != 0 for part in parts.values())
        ]
        if not values:
            continue
        rows = []
        for value in values:
            having = [name for name, part in parts.items() if value in (at(part, ("conditions", kind)) or {})]
            rows += [
                _condition(parts[name], name, (kind, value), names, protocol, first=name == having[0])
                for name in having
            ]
        tables.append((title, head, rows))
    return tables


def _condition(
    part: Mapping[str, Any],
    result: str,
    path: tuple[str, str],
    names: Sequence[str],
    protocol: Protocol,
    *,
    first: bool,
) -> PartRow:
    kind, value = path
    figures, drawn = at(part, ("conditions", kind, value)), at(part, ("intervals", f"{kind}/{value}"))
    counts = at(part, ("counts", kind, value))
    return PartRow(
        title=_SEEN_BY.get(value, value) if kind == "visibility" else value.replace("_", " "),
        result=result,
        first=first,
        cells={
            name: TableCell(value_at(figures, name), _interval(drawn, name), protocol.presenter.unit(name))
            for name in names
        },
        annotated=_integer(counts, "annotated"),
        frames=_integer(counts, "frames"),
    )


def class_rows(parts: Parts, names: Sequence[str], protocol: Protocol) -> list[PartRow]:
    """A row for each class and result, then one of their mean; figures are those of ``names``, or all that there are.

    Args:
        parts: By result name, see :class:`farfield.evaluation.record.Evaluation`.
        names: Figures to take.
        protocol: Says in which units they are shown.
    """
    labels = _names(parts, ("classes",))
    nodes = [at(part, ("classes", label, "figures")) for label in labels for part in parts.values()]
    present = [name for node in nodes if isinstance(node, Mapping) for name in node]
    chosen = [name for name in names if name in present] or list(dict.fromkeys(present))
    rows = []
    for label in _names(parts, ("classes",)):
        having = [name for name, part in parts.items() if label in (at(part, ("classes",)) or {})]
        for name in having:
            row = at(parts[name], ("classes", label))
            title = label.replace("_", " ")
            rows.append(_class_row(row, title, name, chosen, protocol, first=name == having[0]))
    means = {
        name: part["mean_of_classes"]
        for name, part in parts.items()
        if isinstance(part.get("mean_of_classes"), Mapping)
    }
    for index, (name, row) in enumerate(means.items()):
        title = f"mean of {', '.join(row.get('of') or ())}".replace("_", " ")
        rows.append(_class_row(row, title, name, chosen, protocol, first=index == 0))
    return rows


def _class_row(row: Any, title: str, result: str, shown: Sequence[str], protocol: Protocol, *, first: bool) -> PartRow:
    figures = at(row, ("figures",))
    values = figures if isinstance(figures, Mapping) else {}
    return PartRow(
        title=title,
        result=result,
        first=first,
        cells={
            figure_name: TableCell(_number(values.get(figure_name)), None, protocol.presenter.unit(figure_name))
            for figure_name in shown
        },
        annotated=_integer(row, "annotated"),
        why=str(at(row, ("why",)) or "")[:80].replace("_", " "),
    )


def _names(parts: Parts, path: Sequence[str]) -> list[str]:
    nodes = [at(part, path) for part in parts.values()]
    return list(dict.fromkeys(name for node in nodes if isinstance(node, Mapping) for name in node))


def _interval(drawn: Any, name: str) -> tuple[float, float] | None:
    ends = at(drawn, name.split("/"))
    if not isinstance(ends, list) or len(ends) != 2 or any(_number(end) is None for end in ends):
        return None
    return float(ends[0]), float(ends[1])


def _integer(node: Any, name: str) -> int | None:
    value = at(node, (name,))
    return value if isinstance(value, int) else None


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


# An evaluation on the terminal: the table of all classes that stands under a result's own.


def _main_figures(protocol: Protocol, result: Mapping[str, Any]) -> list[str]:
    """The main figure and what belongs beside it; of several classes or measures all that stand side by side."""
    stated = presentation_of(result)
    if protocol.several_classes or protocol.presenter.per_cent:
        return list(stated.figures)
    return [name for name in (stated.main, stated.beside) if name]


def class_table(result: Mapping[str, Any], parts: Mapping[str, Any]) -> str:
    """A table of all classes and their mean; nothing where there are none.

    Args:
        result: Result JSON.
        parts: What was added to it, see :class:`farfield.evaluation.record.Evaluation`.
    """
    rows: dict[str, Any] = dict(parts.get("classes") or {})
    mean = parts.get("mean_of_classes")
    if mean:
        rows[f"mean of {count_of(len(mean['of']), 'class', 'classes')}"] = mean
    protocol = protocol_of(result)
    present = list(dict.fromkeys(name for row in rows.values() for name in row.get("figures") or ()))
    names = [name for name in _main_figures(protocol, result) if name in present] or present
    if not names:
        return ""
    lines = [
        [label.replace("_", " "), f"{row.get('annotated') or 0:,}", *_cells(protocol, row, names)]
        for label, row in rows.items()
        if row.get("figures") or row.get("annotated")
    ]
    return "\n" + table(["class", "objects", *(heading(protocol, name) for name in names)], lines) + "\n\n"


def _cells(protocol: Protocol, row: Mapping[str, Any], names: list[str]) -> list[str]:
    if row.get("why"):
        return [str(row["why"]).replace("_", " "), *[""] * (len(names) - 1)]
    values = [(row["figures"] or {}).get(name) for name in names]
    units = [protocol.presenter.unit(name) for name in names]
    return [NOTHING if value is None else figure_text(value, unit) for value, unit in zip(values, units, strict=True)]


# Results by condition in the form of the K-Radar paper's Table 4: a row a detector, a column a weather.

_TABLE_4 = KRADAR_TABLES["4"]
PUBLISHED_TABLE_4: dict[str, tuple[float, ...]] = {
    name: tuple(part["ap3d"] for part in _TABLE_4.figures[row].values()) for row, name in _TABLE_4.names.items()
}
"""AP3D of Sedan at IoU 0.3 in per cent, in total and by weather as in ``CONDITIONS["weather"]``, by detector."""

PUBLISHED_BY = "kradar-compat:rtnh_narrow: labels v1.0, narrow region, the development kit's first evaluation"
"""The convention of the published table, which is not that of other results."""


def conditional_rows(
    results: Results, *, label: str = "vehicle", measure: str = "3d", iou: float = 0.3, kind: str = "weather"
) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table; figures in per cent, ``-`` where a subset has no annotated box.

    Args:
        results: Result JSON of K-Radar's protocols by the detector's name, all of one convention.
        label: The class.
        measure: ``"3d"`` or ``"bev"``.
        iou: The overlap.
        kind: ``"weather"``, ``"road"`` or ``"time"``.

    Raises:
        ConfigError: If a result is of another protocol, their conventions differ, or one lacks the figure.
    """
    if kind not in CONDITIONS:
        raise ConfigError(f"kind: expected one of {', '.join(CONDITIONS)}, got {kind!r}")
    _check_conventions(results)
    values = list(CONDITIONS[kind])
    for result in results.values():
        values += [value for value in result.get("conditions", {}).get(kind, {}) if value not in values]
    rows = []
    for name, result in results.items():
        by_value = result.get("conditions", {}).get(kind, {})
        parts = [result, *(by_value.get(value) for value in values)]
        cells = [value_at(part, f"ap/{label}/{measure}/{iou:g}") for part in parts]
        if not any(label in (part or {}).get("ap", {}) for part in parts[:1]):
            raise ConfigError(f"{name}: expected figures of class {label!r}, got {', '.join(result.get('ap', {}))}")
        rows.append([name, *("-" if value is None else f"{100 * value:.1f}" for value in cells)])
    return ["", "total", *(value.replace("_", " ") for value in values)], rows


def conditional_markdown(
    results: Results, *, label: str = "vehicle", measure: str = "3d", iou: float = 0.3, kind: str = "weather"
) -> str:
    """The table as Markdown with its convention; arguments and errors as of :func:`conditional_rows`."""
    head, rows = conditional_rows(results, label=label, measure=measure, iou=iou, kind=kind)
    return (
        f"{_title(label, measure, iou)}\n\n{_markdown(head, rows)}\n\n{convention_text(next(iter(results.values())))}\n"
    )


def paper_table(results: Results, *, label: str = "vehicle", figures: Sequence[str] = (), by: str = "none") -> str:
    """The table as Markdown, and under it, as a table of its own, what the paper published of that figure.

    Args:
        results: Result JSON of K-Radar's protocols by the detector's name, all of one convention.
        label: The class.
        figures: One figure, such as ``"bev/0.5"``; none for ``"3d/0.3"``, the paper's.
        by: ``"weather"``, ``"road"`` or ``"time"``; ``"none"`` is the weather.

    Raises:
        ConfigError: As of :func:`conditional_rows`, and if several figures are named.
    """
    kind, (name, *more) = "weather" if by == "none" else by, [*figures, "3d/0.3"][: max(len(figures), 1)]
    measure, _, iou = name.removeprefix(f"ap/{label}/").partition("/")
    if more or measure not in ("3d", "bev") or iou not in _ious(results):
        raise ConfigError(
            f"figures: expected one of 3d/IOU and bev/IOU, IOU of {', '.join(_ious(results))}; got {name!r}"
        )
    text = conditional_markdown(results, label=label, measure=measure, iou=float(iou), kind=kind)
    if (label, measure, iou, kind) != ("vehicle", "3d", "0.3", "weather"):
        return text
    head = ["", "total", *(value.replace("_", " ") for value in CONDITIONS["weather"])]
    rows = [[name, *(f"{value:.1f}" for value in values)] for name, values in PUBLISHED_TABLE_4.items()]
    return f"{text}\nPublished (Table 4): {_title(label, measure, 0.3)}\n\n{_markdown(head, rows)}\n\n{PUBLISHED_BY}\n"


def _ious(results: Results) -> list[str]:
    stated = [f"{iou:g}" for result in results.values() for iou in (result.get("settings") or {}).get("ious") or ()]
    return list(dict.fromkeys(stated)) or ["0.3"]


def _markdown(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _title(label: str, measure: str, iou: float) -> str:
    return f"AP{'3D' if measure == '3d' else '_BEV'} of {label!r} at IoU {iou:g}, per cent; '-': nothing annotated"


def _check_conventions(results: Results) -> None:
    first = next(iter(results), None)
    if first is None:
        raise ConfigError("results: expected at least one, got none")
    for name, result in results.items():
        if protocol_family(result) != "kradar":
            raise ConfigError(f"{name}: expected a result of kradar or kradar-compat, got {result.get('protocol')!r}")
        differing = differing_settings(results[first], result)
        if differing:
            differences = "; ".join(f"{key} ({a} and {b})" for key, (a, b) in differing.items())
            raise ConfigError(f"{first} and {name} have different conventions, so they share no column: {differences}")
