"""Differences between two records."""

import difflib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from record_texts import ruled

_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|nan|inf)(?![\w])")
_SHOWN = 6
"""Lines of a difference that are printed."""


def read_renamings(path: Path) -> dict[str, str]:
    """Words, hyphens included, and what they are called now: a table of two columns; # begins a remark.

    Raises:
        ValueError: If a line has not two words.
    """
    found = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.partition("#")[0].split()
        if words and len(words) != 2:
            raise ValueError(f"{path}, line {number}: expected two words, got {line!r}")
        if words:
            found[words[0]] = words[1]
    return found


def compared(a: Path, b: Path, renamings: Mapping[str, str], tolerance: float) -> Iterator[str]:
    """Each difference as a line, with indented ones that show it."""
    yield from _Comparison(a, b, renamings, tolerance).steps()


class _Comparison:
    def __init__(self, a: Path, b: Path, renamings: Mapping[str, str], tolerance: float) -> None:
        self.a, self.b, self.renamings, self.tolerance = a, b, renamings, tolerance
        words = sorted(renamings, key=len, reverse=True)
        self.pattern = re.compile(rf"(?<![\w-])({'|'.join(map(re.escape, words))})(?![\w-])") if words else None

    def steps(self) -> Iterator[str]:
        """All differences."""
        one, two = (json.loads((folder / "record.json").read_text(encoding="utf-8")) for folder in (self.a, self.b))
        part = bool(one["only"] or two["only"])
        for name in one["steps"] | two["steps"]:
            entries = [each["steps"].get(name) for each in (one, two)]
            if None in entries:
                yield f"{'note: ' if part else ''}{name}: only in {self.b if entries[0] is None else self.a}"
            elif "left out" in entries[0] or "left out" in entries[1]:
                if entries[0] != entries[1]:
                    yield f"note: {name}: left out of one of the records"
            else:
                yield from (f"{each[:4]}{each[4:]}" for each in self._step(name, *entries))

    def _step(self, name: str, one: Mapping[str, Any], two: Mapping[str, Any]) -> Iterator[str]:
        if len(one["commands"]) != len(two["commands"]):
            yield f"{name}: {len(one['commands'])} commands, {len(two['commands'])} commands"
        for number, (first, second) in enumerate(zip(one["commands"], two["commands"], strict=False)):
            if first["status"] != second["status"]:
                yield f"{name}: command {number}: status {first['status']} -> {second['status']}"
            for kind in ("out", "err"):
                if first[kind] != second[kind]:
                    yield from self._texts(name, f"{number}.{kind}", f"{number}.{kind}")
        if sorted(map(self.renamed, one["gone"])) != two["gone"]:
            yield f"{name}: files removed: {one['gone']} -> {two['gone']}"
        files = {self.renamed(each): each for each in one["files"]}
        for path in sorted(files.keys() | two["files"].keys()):
            if path not in two["files"]:
                yield f"{name}: {files[path]}: no longer written"
            elif path not in files:
                yield f"{name}: {path}: newly written"
            elif one["files"][files[path]] != two["files"][path]:
                yield from self._file(name, files[path], path, one["files"][files[path]], two["files"][path])

    def _file(self, step: str, was: str, name: str, one: Mapping[str, Any], two: Mapping[str, Any]) -> Iterator[str]:
        while one["kind"] == two["kind"] == "gz":
            one, two = one["inside"], two["inside"]
        if one["kind"] != two["kind"]:
            yield f"{step}: {name}: {one['kind']} -> {two['kind']}"
        elif one["kind"] == "text":
            yield from self._texts(step, f"files/{was}", f"files/{name}")
        elif one["kind"] == "arrays":
            yield from self._arrays(f"{step}: {name}", one, two)
        else:
            keys = [key for key in one.keys() | two.keys() if one.get(key) != two.get(key)]
            told = ", ".join(f"{key} {one.get(key)} -> {two.get(key)}" for key in sorted(keys))
            yield f"{step}: {name}: {one['kind']}: {told}"

    def _texts(self, step: str, was: str, name: str) -> Iterator[str]:
        paths = (self.a / "texts" / step / was, self.b / "texts" / step / name)
        old, new = (ruled(path.read_text(encoding="utf-8")) for path in paths)
        old = self.renamed(old)
        if old == new or (self.pattern and _collapsed(old) == _collapsed(new)):
            return
        largest = _largest_difference(old, new)
        if largest is not None and largest[0] <= self.tolerance:
            return
        told = "" if largest is None else f"numbers alone, {largest[1]} of them, by {largest[0]:.3g} at most"
        yield f"{step}: {name.removeprefix('files/')}: {told or 'text'}"
        yield from _shown(old, new)

    def _arrays(self, where: str, one: Mapping[str, Any], two: Mapping[str, Any]) -> Iterator[str]:
        for what in ("arrays", "told"):
            old = {self.renamed(key): value for key, value in one[what].items()}
            new = two[what]
            if lost := sorted(old.keys() ^ new.keys()):
                yield f"{where}: {what}: only in one of them: {', '.join(lost[:_SHOWN])}"
            for key in (key for key in old if key in new and old[key] != new[key]):
                line = self._array(old[key], new[key]) if what == "arrays" else self._told(old[key], new[key])
                if line:
                    yield f"{where}: {key}: {line}"

    def _told(self, old: Any, new: Any) -> str:
        if isinstance(old, str) and isinstance(new, str):
            old, new = ruled(old), ruled(new)
            largest = _largest_difference(self.renamed(old), new)
            if self.renamed(old) == new or (largest is not None and largest[0] <= self.tolerance):
                return ""
        shown = difflib.ndiff(_broken(str(old)), _broken(str(new)))
        return "; ".join([each for each in shown if each[0] in "+-"][:_SHOWN])

    def _array(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
        if (old["dtype"], old["shape"]) != (new["dtype"], new["shape"]):
            return f"{old['dtype']} {old['shape']} -> {new['dtype']} {new['shape']}"
        paths = [folder / "arrays" / f"{each['sha']}.npy" for folder, each in ((self.a, old), (self.b, new))]
        if not all(path.exists() for path in paths):
            return "other numbers (not kept)"
        first, second = (np.load(path).astype(float) for path in paths)
        same = (first == second) | (np.isnan(first) & np.isnan(second))
        apart = np.where(same, 0.0, np.abs(first - second))
        if float(np.nan_to_num(apart, nan=np.inf).max()) <= self.tolerance:
            return ""
        return f"{int((~same).sum())} of {same.size} numbers differ, by {np.nanmax(apart):.3g} at most"

    def renamed(self, text: str) -> str:
        """A text of A in today's words."""
        return self.pattern.sub(lambda found: self.renamings[found.group()], text) if self.pattern else text


def _collapsed(text: str) -> str:
    return re.sub(r"[\s\u2500-\u257f]+", "", text)


def _largest_difference(old: str, new: str) -> tuple[float, int] | None:
    """By how much numbers differ and how many do; None where other things than numbers differ."""
    if _NUMBER.sub("#", old) != _NUMBER.sub("#", new):
        return None
    pairs = zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)
    apart = [abs(float(one) - float(two)) for one, two in pairs if one != two]
    return float(np.nan_to_num(apart, nan=np.inf).max()) if apart else 0.0, len(apart)


def _shown(old: str, new: str) -> Iterator[str]:
    shown = 0
    for line in difflib.unified_diff(_broken(old), _broken(new), lineterm="", n=0):
        if line.startswith(("---", "+++", "@@")):
            continue
        shown += 1
        if shown > _SHOWN:
            yield "    ..."
            return
        yield f"    {line[:240]}"


def _broken(text: str) -> list[str]:
    """Lines, long ones broken: a JSON or a page may be one line."""
    return [part for line in text.splitlines() for part in re.findall(r".{1,200}?(?:[,;> ]|$)|.{1,200}", line) or [""]]
