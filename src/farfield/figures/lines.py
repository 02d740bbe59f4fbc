"""An evaluation on the terminal: the table of all classes that stands under a result's own."""

from collections.abc import Mapping
from typing import Any

from farfield.figures.tables import NOTHING, figure_text, heading
from farfield.metrics.protocol import Protocol, protocol_of
from farfield.metrics.result import table


def _main_figures(protocol: Protocol, result: Mapping[str, Any]) -> list[str]:
    """The main figure and what belongs beside it; of several classes or measures all that stand side by side."""
    stated = protocol.presentation(result)
    if protocol.several_classes or protocol.per_cent:
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
        rows[f"mean of {len(mean['of'])} classes"] = mean
    protocol = protocol_of(result)
    found = list(dict.fromkeys(name for row in rows.values() for name in row.get("figures") or ()))
    names = [name for name in _main_figures(protocol, result) if name in found] or found
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
    units = [protocol.unit(name) for name in names]
    return [NOTHING if value is None else figure_text(value, unit) for value, unit in zip(values, units, strict=True)]
