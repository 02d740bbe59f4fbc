"""Tables of an evaluation's parts, for the page: scores by condition and sector, and a row for each class."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from farfield.metrics.result import at, value_at
from farfield.reports.tables import Cell

Parts = Mapping[str, Mapping[str, Any]]
_HEADS = {
    "weather": ("By weather", "weather"),
    "road": ("By road", "road"),
    "time": ("By time of day", "time"),
    "azimuth": ("By direction", "degrees from ahead"),
}


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
    cells: Mapping[str, Cell]
    annotated: int | None = None
    frames: int | None = None
    why: str = ""


def condition_tables(parts: Parts, names: Sequence[str]) -> list[tuple[str, str, list[PartRow]]]:
    """Title, head and rows of a table for each kind of part that has several values.

    Args:
        parts: By result name, see :class:`farfield.reports.evaluation.Evaluation`.
        names: Figures to take, such as ``"dds/0/dds"``.
    """
    tables = []
    for kind, (title, head) in _HEADS.items():
        values = _names(parts, ("conditions", kind))
        if len(values) < 2:
            continue
        rows = []
        for value in values:
            having = [name for name, part in parts.items() if value in (at(part, ("conditions", kind)) or {})]
            rows += [_condition(parts[name], name, kind, value, names, first=name == having[0]) for name in having]
        tables.append((title, head, rows))
    return tables


def _condition(
    part: Mapping[str, Any], result: str, kind: str, value: str, names: Sequence[str], *, first: bool
) -> PartRow:
    figures, drawn = at(part, ("conditions", kind, value)), at(part, ("intervals", f"{kind}/{value}"))
    counts = at(part, ("counts", kind, value))
    return PartRow(
        title=value.replace("_", " "),
        result=result,
        first=first,
        cells={name: Cell(value_at(figures, name), _interval(drawn, name)) for name in names},
        annotated=_whole(counts, "annotated"),
        frames=_whole(counts, "frames"),
    )


def class_rows(parts: Parts, names: Sequence[str]) -> list[PartRow]:
    """A row for each class and result; figures are those of ``names`` that a class has, or all that it has.

    Args:
        parts: By result name, see :class:`farfield.reports.evaluation.Evaluation`.
        names: Figures to take.
    """
    found = [name for label in _names(parts, ("classes",)) for name in _figures(parts, label)]
    shown = [name for name in names if name in found] or list(dict.fromkeys(found))
    rows = []
    for label in _names(parts, ("classes",)):
        having = [name for name, part in parts.items() if label in (at(part, ("classes",)) or {})]
        for name in having:
            row = at(parts[name], ("classes", label))
            figures = at(row, ("figures",))
            known = figures if isinstance(figures, Mapping) else {}
            rows.append(
                PartRow(
                    title=label.replace("_", " "),
                    result=name,
                    first=name == having[0],
                    cells={each: Cell(_number(known.get(each))) for each in shown},
                    annotated=_whole(row, "annotated"),
                    why=str(at(row, ("why",)) or "")[:80].replace("_", " "),
                )
            )
    return rows


def _names(parts: Parts, path: Sequence[str]) -> list[str]:
    nodes = [at(part, path) for part in parts.values()]
    return list(dict.fromkeys(name for node in nodes if isinstance(node, Mapping) for name in node))


def _figures(parts: Parts, label: str) -> list[str]:
    nodes = [at(part, ("classes", label, "figures")) for part in parts.values()]
    return [name for node in nodes if isinstance(node, Mapping) for name in node]


def _interval(drawn: Any, name: str) -> tuple[float, float] | None:
    ends = at(drawn, name.split("/"))
    if not isinstance(ends, list) or len(ends) != 2 or any(_number(end) is None for end in ends):
        return None
    return float(ends[0]), float(ends[1])


def _whole(node: Any, name: str) -> int | None:
    value = at(node, (name,))
    return value if isinstance(value, int) else None


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
