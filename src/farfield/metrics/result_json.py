"""Result JSON held against what :meth:`farfield.metrics.result.Result.to_json` writes, before a page or table reads it.

Files of results are edited, merged and written by other programs. What stands in a wrong place is named by its path in
the file; what is missing stays missing, for results grow from version to version.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from farfield.errors import FileFormatError
from farfield.metrics.result import figure_names

_FIX = "Write it with farfield score --json or farfield evaluate."
_NUMBERS = ("thresholds_m", "epsilons", "ious", "window_m", "origin_m")
_NAMES = ("classes", "ignore")

Steps = tuple[str, ...]
"""The way to a value: keys from the top of the file."""


def check_result(tree: Any, path: Path | str, steps: Steps = ()) -> None:
    """Refuse a result whose figures, ranges, settings, counts, intervals or curves are of another kind.

    Args:
        tree: JSON of a result.
        path: The file.
        steps: Where in the file the result stands.

    Raises:
        FileFormatError: If something is not what a result has there; the message names the place.
    """
    check = _Checker(path)
    check.mapping(tree, steps, "a result with protocol and settings")
    for name, kind, expected in (("protocol", str, "a protocol's name"), ("settings", Mapping, "an object")):
        if not isinstance(tree.get(name), kind):
            check.refuse(tree.get(name), (*steps, name), expected)
    check.text(tree.get("label"), (*steps, "label"))
    _check_settings(check, tree["settings"], (*steps, "settings"))
    for name in ("ap", "errors", "dds"):
        check.entries(tree.get(name), (*steps, name))
    for name in figure_names(tree):
        _check_figure(check, tree, (*steps, *name.split("/")), name)
    for name in ("ranges", "visibility", "mean_of_bins", "conditions", "labels", "counts", "intervals", "curves"):
        if tree.get(name) is not None:
            _PARTS[name](check, tree[name], (*steps, name))
    for number, note in enumerate(check.sequence(tree.get("notes"), (*steps, "notes"))):
        if not isinstance(note, str):
            check.refuse(note, (*steps, "notes", str(number)), "a sentence")


def check_parts(tree: Any, path: Path | str) -> None:
    """Refuse the ``parts`` and ``objects`` of an evaluation where they are of another kind.

    Args:
        tree: JSON of an evaluation.
        path: The file.

    Raises:
        FileFormatError: If something is not what an evaluation has there.
    """
    check = _Checker(path)
    for name, part in check.entries(tree.get("parts"), ("parts",)):
        steps = ("parts", name)
        check.mapping(part, steps, "an object")
        _check_conditions(check, part.get("conditions"), (*steps, "conditions"))
        _check_intervals(check, part.get("intervals"), (*steps, "intervals"))
        _check_counts(check, {"conditions": part.get("counts")}, (*steps, "counts"))
        for label, row in check.entries(part.get("classes"), (*steps, "classes")):
            _check_class_row(check, row, (*steps, "classes", label))
        if part.get("mean_of_classes") is not None:
            _check_class_row(check, part["mean_of_classes"], (*steps, "mean_of_classes"))
    for name, rows in check.entries(tree.get("objects"), ("objects",)):
        steps = ("objects", name)
        check.mapping(rows, steps, "an object")
        lists = {key: check.sequence(rows.get(key), (*steps, key)) for key in ("range_m", "point_count", "found")}
        for key, values in lists.items():
            check.numbers(values, (*steps, key), booleans=key == "found")
        if len({len(values) for values in lists.values()}) > 1:
            counts = ", ".join(f"{len(values)} {key}" for key, values in lists.items())
            check.refuse(counts, steps, "as many of each of range_m, point_count and found")
        for key in ("score_min", "distance_m"):
            if rows.get(key) is not None:
                check.number(rows[key], (*steps, key))


class _Checker:
    """Checks of single values of one file."""

    def __init__(self, path: Path | str) -> None:
        self.path = path

    def refuse(self, value: Any, steps: Steps, expected: str) -> NoReturn:
        """Name the place, what belongs there and what stands there."""
        text = value if isinstance(value, str) else repr(value)
        if isinstance(value, Mapping):
            text = f"an object with {', '.join(map(repr, list(value)[:5])) or 'no key'}"
        where = f"key {'/'.join(steps)!r}"[:200] if steps else "the top"
        raise FileFormatError(self.path, where=where, expected=expected, got=text[:80], fix=_FIX)

    def mapping(self, value: Any, steps: Steps, expected: str) -> None:
        """An object."""
        if not isinstance(value, Mapping):
            self.refuse(value, steps, expected)

    def entries(self, value: Any, steps: Steps) -> list[tuple[str, Any]]:
        """The entries of an object; none of what is not there."""
        if value is None:
            return []
        self.mapping(value, steps, "an object")
        return [(str(name), inner) for name, inner in value.items()]

    def sequence(self, value: Any, steps: Steps) -> Sequence[Any]:
        """A list; an empty one for what is not there."""
        if value is None:
            return ()
        if not isinstance(value, list | tuple):
            self.refuse(value, steps, "a list")
        return value

    def text(self, value: Any, steps: Steps) -> None:
        """A text, or nothing."""
        if value is not None and not isinstance(value, str):
            self.refuse(value, steps, "a text")

    def number(self, value: Any, steps: Steps, *, infinite: bool = False) -> None:
        """A number; a finite one that a float holds unless infinity, in JSON the word ``inf``, may stand there."""
        if infinite and value == "inf":
            return
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not (abs(value) < 1e300 or (infinite and value == math.inf)):
            self.refuse(value, steps, "a finite number")

    def numbers(self, values: Sequence[Any], steps: Steps, *, infinite: bool = False, booleans: bool = False) -> None:
        """A list of numbers."""
        for number, value in enumerate(values):
            if not (booleans and isinstance(value, bool)):
                self.number(value, (*steps, str(number)), infinite=infinite)


def _check_figure(check: _Checker, tree: Mapping[str, Any], steps: Steps, name: str) -> None:
    value: Any = tree
    for step in name.split("/"):
        value = value.get(step) if isinstance(value, Mapping) else None
    if value is not None:
        check.number(value, steps)


def _check_figures(check: _Checker, node: Any, steps: Steps) -> None:
    """A tree whose leaves are numbers or null."""
    if node is None:
        return
    if isinstance(node, Mapping):
        for name, inner in node.items():
            _check_figures(check, inner, (*steps, str(name)))
        return
    check.number(node, steps)


def _check_ranges(check: _Checker, node: Any, steps: Steps) -> None:
    """Figures by range bin, whose names begin with a number of metres."""
    for name, part in check.entries(node, steps):
        try:
            good = math.isfinite(float(name.split("-")[0]))
        except ValueError:
            good = False
        if not good:
            check.refuse(name, steps, "names of range bins such as '70-150'")
        _check_part(check, part, (*steps, name))


def _check_part(check: _Checker, part: Any, steps: Steps) -> None:
    if part is not None:
        check.mapping(part, steps, "an object of figures, or null")
        _check_figures(check, {name: inner for name, inner in part.items() if name in ("ap", "errors", "dds")}, steps)
        for name in figure_names(part):
            _check_figure(check, part, (*steps, *name.split("/")), name)


def _check_by_value(check: _Checker, node: Any, steps: Steps) -> None:
    for value, part in check.entries(node, steps):
        _check_part(check, part, (*steps, value))


def _check_conditions(check: _Checker, node: Any, steps: Steps) -> None:
    for kind, values in check.entries(node, steps):
        _check_by_value(check, values, (*steps, kind))


def _check_labels(check: _Checker, node: Any, steps: Steps) -> None:
    for label, result in check.entries(node, steps):
        check_result(result, check.path, (*steps, label))


def _check_class_row(check: _Checker, row: Any, steps: Steps) -> None:
    """A row of the table of classes, or their mean."""
    check.mapping(row, steps, "an object")
    if row.get("annotated") is not None:
        check.number(row["annotated"], (*steps, "annotated"))
    check.text(row.get("why"), (*steps, "why"))
    for name, value in check.entries(row.get("figures"), (*steps, "figures")):
        _check_figures(check, value, (*steps, "figures", name))
    for number, label in enumerate(check.sequence(row.get("of"), (*steps, "of"))):
        if not isinstance(label, str):
            check.refuse(label, (*steps, "of", str(number)), "a class name")


def _check_counts(check: _Checker, node: Any, steps: Steps) -> None:
    """Numbers of boxes and frames, and the same of each part."""
    for name, value in check.entries(node, steps):
        inner = (*steps, name)
        if name in ("classes", "ranges", "visibility"):
            for part, counts in check.entries(value, inner):
                if counts is not None:
                    _check_counts(check, counts, (*inner, part))
        elif name == "conditions":
            for kind, values in check.entries(value, inner):
                _check_counts(check, {"visibility": values}, (*inner, kind))
        elif (value is not None and not isinstance(value, Mapping | list | str)) or (
            name in ("frames", "frames_given", "annotated", "predictions") and value is not None
        ):
            check.number(value, inner)


def _check_intervals(check: _Checker, node: Any, steps: Steps) -> None:
    for name, inner in check.entries(node, steps):
        if name == "resampled":
            check.text(inner, (*steps, name))
        else:
            _check_interval(check, inner, (*steps, name))


def _check_interval(check: _Checker, node: Any, steps: Steps) -> None:
    """A tree whose leaves are [low, high] or null."""
    if node is None:
        return
    if isinstance(node, Mapping):
        for name, inner in node.items():
            _check_interval(check, inner, (*steps, str(name)))
        return
    if not isinstance(node, list | tuple) or len(node) != 2:
        check.refuse(node, steps, "an interval [low, high], or null")
    check.numbers(node, steps)


def _check_curves(check: _Checker, node: Any, steps: Steps) -> None:
    """A tree whose leaves are curves or null."""
    if node is None:
        return
    check.mapping(node, steps, "an object of curves, or null")
    if "recall" not in node and "precision" not in node:
        for name, inner in node.items():
            _check_curves(check, inner, (*steps, str(name)))
        return
    lists = {name: check.sequence(node.get(name), (*steps, name)) for name in ("recall", "precision")}
    for name, values in lists.items():
        check.numbers(values, (*steps, name))
    if len(lists["recall"]) != len(lists["precision"]):
        counts = " and ".join(str(len(values)) for values in lists.values())
        check.refuse(counts, steps, "lists 'recall' and 'precision' of equal length")


def _check_settings(check: _Checker, settings: Mapping[str, Any], steps: Steps) -> None:
    """The settings that pages and tables read; others are shown as they are."""
    for name in _NUMBERS:
        check.numbers(check.sequence(settings.get(name), (*steps, name)), (*steps, name))
    edges = (*steps, "range_bins_m")
    check.numbers(check.sequence(settings.get("range_bins_m"), edges), edges, infinite=True)
    for name in _NAMES:
        for number, value in enumerate(check.sequence(settings.get(name), (*steps, name))):
            if not isinstance(value, str):
                check.refuse(value, (*steps, name, str(number)), "a class name")
    for old, new in check.entries(settings.get("relabel"), (*steps, "relabel")):
        if not isinstance(new, str):
            check.refuse(new, (*steps, "relabel", old), "a class name")
    check.text(settings.get("label"), (*steps, "label"))
    for name, value in check.entries(settings.get("bootstrap"), (*steps, "bootstrap")):
        check.number(value, (*steps, "bootstrap", name))
    region = settings.get("region")
    if isinstance(region, list):
        check.numbers(region, (*steps, "region"))
        if len(region) != 6:
            check.refuse(region, (*steps, "region"), "a name or six bounds x, x, y, y, z, z")
    else:
        check.text(region, (*steps, "region"))
    for name in ("azimuth_deg", "iou", "min_overlap", "distance_m", "score_cut"):
        if settings.get(name) is not None:
            check.number(settings[name], (*steps, name))


_PARTS: dict[str, Callable[[_Checker, Any, Steps], None]] = {
    "ranges": _check_ranges,
    "visibility": _check_by_value,
    "mean_of_bins": _check_figures,
    "conditions": _check_conditions,
    "labels": _check_labels,
    "counts": _check_counts,
    "intervals": _check_intervals,
    "curves": _check_curves,
}
