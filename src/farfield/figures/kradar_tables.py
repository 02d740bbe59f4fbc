"""Results by condition in the form of the K-Radar paper's Table 4: a row a detector, a column a weather."""

from collections.abc import Mapping, Sequence
from typing import Any

from farfield.errors import ConfigError
from farfield.figures.tables import Results
from farfield.metrics.conventions import convention_text, differing_settings, protocol_family
from farfield.metrics.result import value_at
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.published_tables import KRADAR_TABLES

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
        known = result.get("conditions", {}).get(kind, {})
        parts = [result, *(known.get(value) for value in values)]
        cells = [_figure(part, label, measure, iou) for part in parts]
        if not any(label in (part or {}).get("ap", {}) for part in parts[:1]):
            raise ConfigError(f"{name}: expected figures of class {label!r}, got {', '.join(result.get('ap', {}))}")
        rows.append([name, *("-" if value is None else f"{100 * value:.1f}" for value in cells)])
    return ["", "total", *(value.replace("_", " ") for value in values)], rows


def conditional_markdown(
    results: Results, *, label: str = "vehicle", measure: str = "3d", iou: float = 0.3, kind: str = "weather"
) -> str:
    """The table as Markdown with its convention; arguments and errors as of :func:`conditional_rows`."""
    head, rows = conditional_rows(results, label=label, measure=measure, iou=iou, kind=kind)
    return f"{_title(label, measure, iou)}\n\n{_markdown(head, rows)}\n\n{_convention(results)}\n"


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
    found = [f"{iou:g}" for result in results.values() for iou in (result.get("settings") or {}).get("ious") or ()]
    return list(dict.fromkeys(found)) or ["0.3"]


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
            words = "; ".join(f"{key} ({a} and {b})" for key, (a, b) in differing.items())
            raise ConfigError(f"{first} and {name} have different conventions, so they share no column: {words}")


def _convention(results: Results) -> str:
    return convention_text(next(iter(results.values())))


def _figure(part: Mapping[str, Any] | None, label: str, measure: str, iou: float) -> float | None:
    return value_at(part, f"ap/{label}/{measure}/{iou:g}")
