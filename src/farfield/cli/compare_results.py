"""``farfield compare-results``: results side by side, never two conventions in one column."""

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

Tree = Mapping[str, Any]
By = Literal["none", "weather", "road", "time", "range", "visibility"]
_MAX_BYTES = 1 << 28


@dataclass(frozen=True)
class Entry:
    """One result of one class.

    Args:
        name: What its row is called.
        family: The protocol without its variant.
        label: The class.
        tree: Result JSON.
    """

    name: str
    family: str
    label: str
    tree: Tree


@dataclass(frozen=True)
class Column:
    """One figure of one part of the results: ``("ranges", "0-70")``, ``("conditions", "weather", "fog")`` or ``()``."""

    title: str
    figure: str
    part: tuple[str, ...] = ()


def run(
    results: Positional[tuple[Path, ...]],
    *,
    names: str = "",
    label: str | None = None,
    figures: tuple[str, ...] = (),
    by: By = "none",
    separate: bool = False,
) -> int:
    """Set results side by side, a row a result; numbers of different conventions never share a column.

    examples:
      farfield compare-results rtnh.json rtn.json pointpillars.json
      farfield compare-results rtnh.json rtn.json --by weather --figures 3d/0.3 --label vehicle
      farfield compare-results ours.json theirs.json --separate
      farfield compare-results a.json b.json --by range --figures dds/0.003/dds

    Reads what farfield score --json and farfield evaluate write. Two results are of one convention if they agree in
    every setting that their figures depend on. If they do not, the command says in which they differ and stops, or,
    with --separate, gives each convention columns of its own and names it.

    Args:
        results: JSON files of results.
        names: What to call the rows, separated by commas; the files' names unless given.
        label: The class; all unless given.
        figures: Figures to show, such as dds/0/map or, of K-Radar's protocols, 3d/0.3; a choice unless given.
        by: Columns: none: the figures of the whole; else the parts by that, a table a figure.
        separate: Put numbers of different conventions into separate columns.
    """
    from farfield.errors import ConfigError

    entries = _entries(results, names)
    groups = dict.fromkeys((entry.family, entry.label) for entry in entries if label in (None, entry.label))
    if not groups:
        present = ", ".join(dict.fromkeys(entry.label for entry in entries))
        raise ConfigError(f"--label: expected one of {present}; got {label!r}")
    tables: list[str] = []
    for group in groups:
        members = [entry for entry in entries if (entry.family, entry.label) == group]
        tables += _tables(members, figures=figures, by=by, separate=separate)
    print("\n\n".join(tables))
    return 0


def _tables(members: list[Entry], *, figures: tuple[str, ...], by: By, separate: bool) -> list[str]:
    """Tables of one protocol and class, then their conventions and what is to be known of the data."""
    conventions = _conventions(members, by_range=by == "range", separate=separate)
    letters = {entry.name: letter for entry, letter in zip(members, conventions, strict=True)}
    tables = [
        f"{members[0].family}, {members[0].label}{title}{_unit(members[0])}; '-': nothing annotated\n\n"
        + _layout(members, columns, letters)
        for title, columns in _columns(members, figures, by)
    ]
    return [*tables, _footer(members, letters, by_range=by == "range")]


def _layout(members: list[Entry], columns: list[Column], letters: Mapping[str, str]) -> str:
    """The table; where there are several conventions, each figure has a column for each of them."""
    from farfield.metrics.result import table

    kinds = list(dict.fromkeys(letters.values()))
    head = [column.title + (f" [{kind}]" if len(kinds) > 1 else "") for column in columns for kind in kinds]
    rows = []
    for entry in members:
        mine = letters[entry.name]
        cells = [_cell(entry, column) if kind == mine else "" for column in columns for kind in kinds]
        rows.append([entry.name, *cells])
    return table(["", *head], rows)


def _cell(entry: Entry, column: Column) -> str:
    value = _value(entry.tree, column)
    if value is None:
        return "-"
    return f"{100 * value:.2f}" if _unit(entry) else f"{value:.4f}"


def _unit(entry: Entry) -> str:
    return ", per cent" if entry.family in ("kitti", "kradar") else ""


def _footer(members: list[Entry], letters: Mapping[str, str], *, by_range: bool) -> str:
    from farfield.metrics.conventions import convention_text

    firsts: dict[str, Entry] = {}
    for entry in members:
        firsts.setdefault(letters[entry.name], entry)
    lines = []
    for letter, entry in firsts.items():
        mark = f"[{letter}] " if len(firsts) > 1 else ""
        text = mark + convention_text(entry.tree, by_range=by_range)
        lines.append(textwrap.fill(text, 116, subsequent_indent="  ", break_on_hyphens=False))
    data = {entry.name: _data(entry) for entry in members}
    if len(set(data.values())) > 1:
        told = "; ".join(f"{name}: {frames} frames, {boxes} annotated" for name, (frames, boxes) in data.items())
        lines.append(f"note: not the same data. {told}")
    return "\n".join(lines)


def _data(entry: Entry) -> tuple[Any, Any]:
    counts = entry.tree.get("counts") or {}
    mine = _at(counts, ("classes", entry.label)) or counts
    return counts.get("frames_given"), mine.get("annotated")


def _conventions(members: list[Entry], *, by_range: bool, separate: bool) -> list[str]:
    """A letter for the convention of each result; there is one letter only unless they may stand apart."""
    from farfield.errors import ConfigError
    from farfield.metrics.conventions import differing_settings

    firsts: list[Entry] = []
    letters = []
    for entry in members:
        same = [not differing_settings(first.tree, entry.tree, by_range=by_range) for first in firsts]
        if not any(same):
            if firsts and not separate:
                differing = differing_settings(firsts[0].tree, entry.tree, by_range=by_range)
                words = "; ".join(f"{name}: {a} and {b}" for name, (a, b) in differing.items())
                raise ConfigError(
                    f"{firsts[0].name} and {entry.name} were scored by different conventions ({words}), so their "
                    "numbers do not belong in one column. Score them alike, or give each its own with --separate"
                )
            firsts.append(entry)
            same.append(True)
        letters.append(chr(ord("A") + same.index(True)) if same.index(True) < 26 else f"Z{same.index(True)}")
    return letters


def _entries(paths: Sequence[Path], names: str) -> list[Entry]:
    from farfield.errors import ConfigError
    from farfield.metrics.conventions import protocol_family

    found: list[tuple[str, Tree]] = []
    for path in paths:
        trees = _read(path)
        found += [(path.stem if len(trees) == 1 else f"{path.stem}: {name}", tree) for name, tree in trees.items()]
    called = [word.strip() for word in names.split(",")] if names else [name for name, _ in found]
    if not found or len(called) != len(found) or not all(called):
        raise ConfigError(f"expected one or more results and as many names, got {len(found)} and {names!r}")
    if len(set(called)) < len(called):
        called = [f"{number}: {name}" for number, name in enumerate(called, 1)]
    entries = []
    for name, (_, tree) in zip(called, found, strict=True):
        family = protocol_family(tree)
        if family == "kradar":
            entries += [Entry(name, family, str(label), tree) for label in tree["settings"].get("classes") or ()]
        else:
            classes = tree.get("labels") or {tree.get("label", ""): tree}
            entries += [Entry(name, family, str(label), each) for label, each in classes.items()]
    return entries


def _read(path: Path) -> dict[str, Tree]:
    """Results of a file: one of ``farfield score``, or those of each cloud of ``farfield evaluate``."""
    from farfield.errors import ConfigError, FileFormatError
    from farfield.files.atomic import read_bytes

    if not path.is_file():
        raise ConfigError(f"{path}: expected a JSON file of results, found none there")
    try:
        tree = json.loads(read_bytes(path, max_bytes=_MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(path, where="the text", expected="JSON", found=str(error)[:100]) from None
    inner = tree.get("results") if isinstance(tree, dict) else None
    found = inner if isinstance(inner, dict) and "protocol" not in tree else {"": tree}
    for result in found.values():
        _check(path, result)
        for each in (result.get("labels") or {}).values():
            _check(path, each)
    return found


def _check(path: Path, result: Any) -> None:
    from farfield.errors import FileFormatError

    good = (
        isinstance(result, dict)
        and isinstance(result.get("protocol"), str)
        and isinstance(result.get("settings"), dict)
        and isinstance(result.get("labels") or {}, dict)
        and isinstance(result.get("counts") or {}, dict)
    )
    if not good:
        raise FileFormatError(
            path,
            where="the top",
            expected="a result with protocol and settings",
            found=f"{type(result).__name__} with {', '.join(map(str, result))[:80]}"
            if isinstance(result, dict)
            else type(result).__name__,
            mend="Write it with farfield score --json or farfield evaluate.",
        )


def _columns(members: list[Entry], figures: tuple[str, ...], by: By) -> list[tuple[str, list[Column]]]:
    """Title and columns of each table."""
    from farfield.errors import ConfigError

    trees = [entry.tree for entry in members]
    prefix = f"ap/{members[0].label}/" if members[0].family == "kradar" else ""
    wanted = [name if name.startswith(prefix) else prefix + name for name in figures] or _usual(trees, prefix, by)
    for name in wanted:
        if not any(name.split("/")[-1] in _node(tree, name) for tree in trees):
            present = [leaf.removeprefix(prefix) for tree in trees for leaf in _all_figures(tree, prefix)]
            raise ConfigError(f"--figures: expected some of {', '.join(dict.fromkeys(present))}; got {name!r}")
    if by == "none":
        return [("", [Column(_title(name, prefix), name) for name in wanted])]
    return [(f", {_title(name, prefix)}", [Column("total", name), *_part_columns(trees, name, by)]) for name in wanted]


def _part_columns(trees: list[Tree], figure: str, by: str) -> list[Column]:
    from farfield.errors import ConfigError
    from farfield.vocabulary.conditions import CONDITIONS

    home = {"range": ("ranges",), "visibility": ("visibility",)}.get(by, ("conditions", by))
    present: list[str] = list(CONDITIONS.get(by, ()))
    for tree in trees:
        node = _at(tree, home)
        present += [name for name in (node if isinstance(node, dict) else {}) if name not in present]
    if not any(_at(tree, home) for tree in trees):
        raise ConfigError(f"--by {by}: none of the results has figures by {by}; see farfield score --help")
    return [Column(name.replace("_", " "), figure, (*home, name)) for name in present]


def _usual(trees: list[Tree], prefix: str, by: str) -> list[str]:
    """Figures that are shown if none are named; of the parts only the first of them."""
    found = list(dict.fromkeys(leaf for tree in trees for leaf in _all_figures(tree, prefix)))
    if not prefix:
        scores = [name for name in found if name.startswith("dds/") and name.endswith("/dds")]
        plain = [name for name in found if name in ("dds/0/map", "dds/0/aiou", "map")]
        found = [*scores, *plain] or [name for name in found if "r40" in name] or found
    return found[: 1 if by != "none" else None]


def _all_figures(tree: Tree, prefix: str) -> list[str]:
    """Names of all figures, of K-Radar's protocols those of one class."""
    if prefix:
        return list(_leaves(_at(tree, prefix.strip("/").split("/")), prefix.strip("/")))
    named = [name for part in ("dds", "ap", "errors") for name in _leaves(tree.get(part), part)]
    return [*named, *(["map"] if "map" in tree else [])]


def _leaves(node: Any, path: str) -> Iterator[str]:
    if isinstance(node, Mapping):
        for name, inner in node.items():
            yield from _leaves(inner, f"{path}/{name}")
    else:
        yield path


def _title(figure: str, prefix: str) -> str:
    words = figure.removeprefix(prefix).removeprefix("ap/").split("/")
    if words[0] == "dds" and len(words) == 3:
        score = "DDS" if words[1] == "0" else f"wDDS {words[1]}"
        return score if words[2] == "dds" else {"map": "mAP", "aiou": "aIoU"}.get(words[2], words[2])
    return " ".join(words).replace("3d", "3D").replace("bev", "BEV")


def _node(tree: Tree, figure: str) -> Mapping[str, Any]:
    node = _at(tree, figure.split("/")[:-1])
    return node if isinstance(node, Mapping) else {}


def _at(tree: Any, path: Sequence[str]) -> Any:
    for step in path:
        if not isinstance(tree, Mapping) or step not in tree:
            return None
        tree = tree[step]
    return tree


def _value(tree: Tree, column: Column) -> float | None:
    value = _at(_at(tree, column.part), column.figure.split("/"))
    return float(value) if isinstance(value, float | int) and not isinstance(value, bool) else None
