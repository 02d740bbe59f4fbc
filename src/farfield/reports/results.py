"""Read figures out of result JSON (what ``farfield score`` writes); what is absent or null comes back as None."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

Result = Mapping[str, Any]


def _at(tree: Any, *path: str) -> Any:
    for step in path:
        if not isinstance(tree, Mapping) or step not in tree:
            return None
        tree = tree[step]
    return tree


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
    home = result if part == "overall" else _at(result, "ranges", part)
    value = _at(home, *name.split("/"))
    return None if value is None else float(value)


def ap_names(results: Mapping[str, Result]) -> list[str]:
    """Names of all APs that at least one result has, such as ``"ap/0.5"`` or ``"ap/3d/r40/moderate"``, in order."""
    found = [name for result in results.values() for name in _leaves(result.get("ap") or {}, "ap")]
    return sorted(dict.fromkeys(found), key=_by_number)


def _leaves(tree: Mapping[str, Any], path: str) -> Iterator[str]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}/{name}")
        else:
            yield f"{path}/{name}"


def _by_number(name: str) -> tuple[float, str]:
    last = name.rpartition("/")[2]
    return (float(last), "") if last.replace(".", "", 1).isdecimal() else (0.0, "")


def interval(result: Result, name: str, *, part: str = "overall") -> tuple[float, float] | None:
    """The bootstrap interval of a figure, or None."""
    value = _at(result, "intervals", part, *name.split("/"))
    return (float(value[0]), float(value[1])) if isinstance(value, list | tuple) and len(value) == 2 else None


def counts(result: Result, *, part: str = "overall") -> dict[str, int]:
    """Counts of annotated boxes and predictions, as far as the result has them."""
    found = _at(result, "counts") if part == "overall" else _at(result, "counts", "ranges", part)
    return {name: int(value) for name, value in (found or {}).items() if isinstance(value, int)}


def curves(result: Result, *, part: str = "overall", epsilon: float = 0.0) -> dict[str, Mapping[str, Any] | None]:
    """Sampled curves by threshold (``recall``, ``precision``, ``confidence``); None where nothing is annotated."""
    return dict(_at(result, "curves", part, f"{epsilon:g}") or {})


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
