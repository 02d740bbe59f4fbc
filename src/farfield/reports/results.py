"""Read figures out of result JSON (what ``farfield score`` writes); what is absent or null comes back as None."""

from collections.abc import Iterable, Mapping
from typing import Any

from farfield.errors import ConfigError
from farfield.metrics.result import at, leaves

Result = Mapping[str, Any]


def part_names(result: Result) -> list[str]:
    """Names of the range bins, near to far."""
    names = result.get("ranges") or {}
    return sorted(names, key=lambda name: float(name.split("-")[0]))


def epsilons(result: Result) -> list[str]:
    """Names of the epsilons, rising: ``["0", "0.003", ...]``."""
    return sorted(result.get("dds") or {}, key=float)


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


def ap_names(results: Mapping[str, Result]) -> list[str]:
    """Names of all APs that at least one result has, such as ``"ap/0.5"`` or ``"ap/3d/r40/moderate"``, in order."""
    found = [name for result in results.values() for name in leaves(result.get("ap") or {}, "ap")]
    return sorted(dict.fromkeys(found), key=_by_number)


def _by_number(name: str) -> tuple[float, str]:
    last = name.rpartition("/")[2]
    return (float(last), "") if last.replace(".", "", 1).isdecimal() else (0.0, "")


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


def curves(result: Result, *, part: str = "overall", epsilon: float = 0.0) -> dict[str, Mapping[str, Any] | None]:
    """Sampled curves by threshold (``recall``, ``precision``, ``confidence``); None where nothing is annotated."""
    found = dict(at(result, ("curves", part, f"{epsilon:g}")) or {})
    for threshold, curve in found.items():
        recall, precision = at(curve, ("recall",)), at(curve, ("precision",))
        good = isinstance(recall, list) and isinstance(precision, list) and len(recall) == len(precision)
        if curve is not None and not good:
            raise ConfigError(
                f"result, curve of {part} at {threshold} m: expected lists 'recall' and 'precision' of equal length. "
                "Score the predictions again."
            )
    return found


def curve_names(names: Iterable[str]) -> list[str]:
    """Threshold names, rising."""
    return sorted(names, key=float)


def scored_labels(results: Mapping[str, Result]) -> tuple[str, ...] | None:
    """Classes that count in the scores, merged ones included; None where the results do not say."""
    for result in results.values():
        settings = result.get("settings") or {}
        label = result.get("label") or settings.get("label")
        if label:
            merged = [name for name, target in (settings.get("relabel") or {}).items() if target == label]
            return (str(label), *merged)
    return None
