"""Read figures out of result JSON (what ``farfield score`` writes); what is absent or null comes back as None."""

from collections.abc import Mapping
from typing import Any

from farfield.errors import ConfigError
from farfield.metrics.result import at

Result = Mapping[str, Any]


def part_names(result: Result) -> list[str]:
    """Names of the range bins, near to far."""
    names = result.get("ranges") or {}
    return sorted(names, key=lambda name: float(name.split("-")[0]))


def figure(result: Result, name: str, *, part: str = "overall") -> float | None:
    """One figure such as ``"dds/0/map"`` or ``"ap/0.5"`` of the whole or of a range bin.

    Args:
        result: Result JSON.
        name: Path of the figure.
        part: ``"overall"`` or a range bin's name.
    """
    home = result if part == "overall" else at(result, ("ranges", part))
    value = at(home, name.split("/"))
    return None if value is None else _number(value, f"{part} {name}")


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"result, {where}: expected a number or null, got {value!r}. Score the predictions again.")
    return float(value)


def interval(result: Result, name: str, *, part: str = "overall") -> tuple[float, float] | None:
    """The bootstrap interval of a figure, or None."""
    value = at(result, ("intervals", part, *name.split("/")))
    if not isinstance(value, list | tuple) or len(value) != 2:
        return None
    return _number(value[0], f"interval of {name}"), _number(value[1], f"interval of {name}")


def counts(result: Result, *, part: str = "overall") -> dict[str, int]:
    """Counts of annotated boxes and predictions, as far as the result has them."""
    found = at(result, ("counts",)) if part == "overall" else at(result, ("counts", "ranges", part))
    return {name: int(value) for name, value in (found or {}).items() if isinstance(value, int)}


def scored_labels(results: Mapping[str, Result]) -> tuple[str, ...] | None:
    """Classes that count in the scores, merged ones included; None where the results do not say."""
    for result in results.values():
        settings = result.get("settings") or {}
        one = result.get("label") or settings.get("label")
        labels = settings.get("classes") or ([one] if one else [])
        if labels:
            merged = [name for name, target in (settings.get("relabel") or {}).items() if target in labels]
            return tuple(dict.fromkeys([*map(str, labels), *merged]))
    return None
