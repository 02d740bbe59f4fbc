"""Tables of an evaluation's parts, for the page: scores by condition and sector, and a row for each class."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from farfield.figures.tables import TableCell
from farfield.metrics.protocol import Protocol
from farfield.metrics.result import at, value_at

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
        tree["intervals"] |= {part: each for part, each in (result.get("intervals") or {}).items() if "/" in part}
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
        values = [value for value in _names(parts, ("conditions", kind)) if _has_frames(parts, kind, value)]
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


def _has_frames(parts: Parts, kind: str, value: str) -> bool:
    """Whether a part has frames, or nothing says how many it has."""
    return any(at(part, ("counts", kind, value, "frames")) != 0 for part in parts.values())


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
        cells={name: TableCell(value_at(figures, name), _interval(drawn, name), protocol.unit(name)) for name in names},
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
    found = [name for label in _names(parts, ("classes",)) for name in _figure_names(parts, label)]
    shown = [name for name in names if name in found] or list(dict.fromkeys(found))
    rows = []
    for label in _names(parts, ("classes",)):
        having = [name for name, part in parts.items() if label in (at(part, ("classes",)) or {})]
        for name in having:
            row = at(parts[name], ("classes", label))
            title = label.replace("_", " ")
            rows.append(_class_row(row, title, name, shown, protocol, first=name == having[0]))
    means = {
        name: part["mean_of_classes"]
        for name, part in parts.items()
        if isinstance(part.get("mean_of_classes"), Mapping)
    }
    for place, (name, row) in enumerate(means.items()):
        title = f"mean of {', '.join(row.get('of') or ())}".replace("_", " ")
        rows.append(_class_row(row, title, name, shown, protocol, first=place == 0))
    return rows


def _class_row(row: Any, title: str, result: str, shown: Sequence[str], protocol: Protocol, *, first: bool) -> PartRow:
    figures = at(row, ("figures",))
    known = figures if isinstance(figures, Mapping) else {}
    return PartRow(
        title=title,
        result=result,
        first=first,
        cells={each: TableCell(_number(known.get(each)), None, protocol.unit(each)) for each in shown},
        annotated=_integer(row, "annotated"),
        why=str(at(row, ("why",)) or "")[:80].replace("_", " "),
    )


def _names(parts: Parts, path: Sequence[str]) -> list[str]:
    nodes = [at(part, path) for part in parts.values()]
    return list(dict.fromkeys(name for node in nodes if isinstance(node, Mapping) for name in node))


def _figure_names(parts: Parts, label: str) -> list[str]:
    nodes = [at(part, ("classes", label, "figures")) for part in parts.values()]
    return [name for node in nodes if isinstance(node, Mapping) for name in node]


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
