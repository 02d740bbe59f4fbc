"""Structural edits of configuration: mappings of classes, splits, conditions, descriptions, experiments, schemas."""

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _labelled_rows import LAYOUTS, STRANGE, Draft, encoded
from _structures import Case, Family, Reading

from farfield.annotation.schema import SCHEMA, Schema, load_schema
from farfield.datasets.cirrus.layout import read_mapping
from farfield.datasets.class_mapping import read_class_mapping
from farfield.datasets.splits import read_parts
from farfield.experiments.schema import load_experiment
from farfield.metrics.kradar.conditions import read_conditions

UNITS = ("drive_1", "drive_2", "drive_3", "drive_4")
Edit = Callable[[Draft, Any], Any]


def equal(expected: Any, actual: Any) -> str:
    return "" if actual == expected else f"{actual!r} in place of {expected!r}"[:200]


def stored(draft: Draft, path: Path, text: str) -> None:
    """Write a text, sometimes in another encoding, sometimes something else in its place."""
    strange = draft.random.random() < 0.1
    kinds = [kind for kind in STRANGE if kind != "UTF-16" or path.suffix != ".yaml"] if strange else LAYOUTS
    path.write_bytes(encoded(draft, text, kinds))


def case(draft: Draft, read: Callable[[], Any], expected: Any) -> Case:
    edits = tuple(draft.edits or ["none"])
    return Case(edits, draft.oracle, lambda: Reading(read()), partial(equal, expected), draft.words)


def class_mapping(random: np.random.Generator, folder: Path) -> Case:
    """``mapping.yaml`` of an own folder."""
    draft = Draft(random, [])
    classes = {"Auto": "vehicle", "LKW": "large_vehicle", "Radfahrer": "bicycle", "Cone 1": "Cone"}
    lines = [f"  {name}: {ours}" for name, ours in classes.items()]
    kind = draft.pick(["none", "none", "line", "line", "line", "key", "order", "flow", "quotes"])
    head = "classes:"
    if kind == "line":
        line = draft.pick(
            ["Auto: animal", "Van: true", "Van: 3", "Van: null", "Van: [vehicle]", "Van: {a: b}", "Van:", "- a"]
        )
        lines.append(f"  {line}")
        draft.note(f"{line!r} more", "refused")
    elif kind == "key":
        head = draft.pick(["class:", "Classes:", "labels:", "mapping:", "classes"])
        draft.note(f"{head} for classes:", "refused")
    elif kind == "order":
        lines.reverse()
        draft.note("another order")
    elif kind == "quotes":
        lines = [f'  "{name}": "{ours}"' for name, ours in classes.items()]
        draft.note("in quotes")
    text = "\n".join([head, *lines]) + "\n"
    if kind == "flow":
        text = json.dumps({"classes": classes})
        draft.note("as JSON")
    stored(draft, folder / "mapping.yaml", text)
    return case(draft, lambda: dict(read_class_mapping(folder / "mapping.yaml")), classes)


def cirrus_mapping(random: np.random.Generator, folder: Path) -> Case:
    """The mapping of a Cirrus layout."""
    draft = Draft(random, [])
    tree: dict[str, Any] = {
        "labels": {"size_order": "wlh", "quat_order": "wxyz", "yaw_offset_deg": 90.0},
        "pairing": {"max_dt_ms": 50.0},
        "segments": {"gap_s": 2.0},
    }
    expected = ("wlh", "wxyz", 90.0, 50.0, 2.0)
    group = draft.pick(list(tree))
    key = draft.pick(list(tree[group]))
    kind = draft.pick(["none", "value", "value", "key", "group", "text"])
    if kind == "value":
        tree[group][key] = draft.pick([None, [1], {"a": 1}, "hello", True, float("nan")])
        draft.note(f"{tree[group][key]} as {key}", "refused")
    elif kind == "key":
        tree[group][key.upper()] = tree[group].pop(key)
        draft.note("key misspelt", "refused")
    elif kind == "group":
        tree[group.upper()] = tree.pop(group)
        draft.note("group misspelt", "refused")
    elif kind == "text" and isinstance(tree[group][key], float):
        tree[group][key] = f"{tree[group][key]:g}"
        draft.note("number as text", "either")
    stored(draft, folder / "mapping.yaml", json.dumps(tree, indent=1).replace("NaN", ".nan"))
    return case(draft, lambda: _layout(folder / "mapping.yaml"), expected)


def _layout(path: Path) -> tuple[Any, ...]:
    mapping = read_mapping(path)
    labels = mapping.labels
    return (
        labels.size_order,
        labels.quat_order,
        labels.yaw_offset_deg,
        mapping.pairing.max_dt_ms,
        mapping.segments.gap_s,
    )


def splits(random: np.random.Generator, folder: Path) -> Case:
    """A file of splits."""
    draft = Draft(random, [])
    parts: dict[str, Any] = {"train": list(UNITS[:2]), "val": [UNITS[2]], "test": [UNITS[3]]}
    expected = {name: list(units) for name, units in parts.items()}
    kind = draft.pick(["none", "part left out", "unit", "twice", "both", "kind", "name", "key", "cut"])
    name = draft.pick(list(parts))
    if kind == "part left out":
        del parts[name], expected[name]
        draft.note(kind)
    elif kind == "unit":
        parts[name].append(draft.pick([3, None, True, ["drive_1"], "drive_9", "", "Drive_1", " drive_1"]))
        draft.note(f"{parts[name][-1]!r} as a unit", "refused")
    elif kind == "twice":
        parts[name].append(parts[name][0])
        expected[name].append(parts[name][0])
        draft.note("a unit twice in a part")
    elif kind == "both":
        other = draft.pick([part for part in parts if part != name])
        parts[other].append(parts[name][0])
        draft.note("a unit in two parts", "refused")
    elif kind == "kind":
        parts[name] = draft.pick([None, "drive_1", {"drive_1": 1}, 3])
        draft.note("no list", "refused")
    text = json.dumps(draft.pick([[parts], 3, None]) if kind == "name" else parts)
    if kind == "name":
        draft.note("another root", "refused")
    elif kind == "key":
        text = text.replace("{", '{"val": ["drive_1"], ', 1)
        draft.note("a part twice", "refused")
    elif kind == "cut":
        text = draft.pick([text[:-5], text.replace('"', "'"), "[" * 100_000])
        draft.note("no JSON", "refused")
    stored(draft, folder / "splits.json", text)
    return case(draft, lambda: read_parts(folder / "splits.json", UNITS), expected)


def conditions(random: np.random.Generator, folder: Path) -> Case:
    """A table of K-Radar's conditions, or descriptions beside the sequences."""
    draft = Draft(random, [])
    words = {"1": ("urban", "day", "normal"), "2": ("highway", "night", "rain"), "3": ("mountain", "day", "fog")}
    rows = [["sequence", "road", "time", "weather"], *([name, *values] for name, values in words.items())]
    expected = {
        ("1", "a"): {"road": "urban", "time": "day", "weather": "normal"},
        ("2", "a"): {"road": "highway", "time": "night", "weather": "rain"},
        ("3", "a"): {"road": "mountain", "time": "day", "weather": "fog"},
    }
    kind = draft.pick(["none", "columns", "header", "exchanged", "twice", "cell", "letters", "separator", "missing"])
    place = int(random.integers(1, 4))
    if kind == "columns":
        order = random.permutation(4)
        rows = [[row[column] for column in order] for row in rows]
        draft.note("columns in another order")
    elif kind == "header":
        rows[0][int(random.integers(4))] = draft.pick(["light", "seq", "", "weather2"])
        draft.note("header", "refused")
    elif kind == "exchanged":
        rows[0][1:] = ["weather", "road", "time"]
        draft.note("words under another header", "refused")
    elif kind == "twice":
        rows.append([*rows[place][:1], "urban", "night", "normal"])
        draft.note("a sequence twice", "refused")
    elif kind == "cell":
        rows[place][int(random.integers(4))] = ""
        draft.note("an empty cell", "refused")
    elif kind == "letters":
        rows = [[draft.pick([str.upper, str.title, str])(cell) for cell in row] for row in rows]
        draft.note("other letters")
    elif kind == "missing":
        del rows[place], expected[str(place), "a"]
        draft.note("a sequence missing")
    separator = ";" if kind == "separator" else ","
    draft.note("semicolons", "refused") if separator == ";" else None
    stored(draft, folder / "conditions.csv", "".join(separator.join(row) + "\n" for row in rows))
    keys = [(name, "a") for name in words]
    return case(draft, lambda: read_conditions(folder / "conditions.csv", keys), expected)


def descriptions(random: np.random.Generator, folder: Path) -> Case:
    """K-Radar's ``description.txt``: road, time, weather."""
    draft = Draft(random, [])
    words = ["urban", "night", "heavysnow"]
    expected = {("1", "a"): {"road": "urban", "time": "night", "weather": "heavy_snow"}}
    kind = draft.pick(["none", "blanks", "letters", "order", "fewer", "more", "empty"])
    line = ",".join(words)
    if kind == "blanks":
        line = " , ".join(words)
        draft.note(kind)
    elif kind == "letters":
        line = line.upper()
        draft.note(kind)
    elif kind == "order":
        line = draft.pick(["night,urban,heavysnow", "heavysnow,night,urban", "urban,heavysnow,night"])
        draft.note("another order", "refused")
    elif kind != "none":
        line = {"fewer": "urban,night", "more": "urban,night,heavysnow,1", "empty": ""}[kind]
        draft.note(kind, "refused")
    (folder / "1").mkdir()
    stored(draft, folder / "1" / "description.txt", line + "\n")
    return case(draft, lambda: read_conditions(folder, [("1", "a")]), expected)


_SETTINGS: tuple[tuple[str, str, Any], ...] = (
    ("training", "steps", 120),
    ("training", "batch_size", 2),
    ("training", "learning_rate", 0.002),
    ("training", "seed", 5),
)


def experiments(random: np.random.Generator, folder: Path) -> Case:
    """An experiment over a shipped one."""
    draft = Draft(random, [])
    chosen = [setting for setting in _SETTINGS if random.random() < 0.7] or [_SETTINGS[0]]
    tree: dict[str, Any] = {"name": "mine", "extends": "pointpillars-cirrus-sim", "training": {}}
    expected = {}
    for group, key, value in chosen:
        tree[group][key] = value
        expected[key] = value
    _, key, value = draft.pick(chosen)
    kind = draft.pick(["none", "value", "value", "value", "key", "group", "twice", "root", "deep"])
    training = tree["training"]
    if kind == "value":
        training[key] = draft.pick([None, "many", [3], {"a": 1}, True, [], float("nan"), float("inf")])
        draft.note(f"{training[key]!r} as {key}", "refused")
    elif kind == "key":
        training[draft.pick([key.upper(), key + "s", key.replace("_", "-") + "_"])] = training.pop(key)
        draft.note("key misspelt", "refused")
    elif kind == "group":
        tree["trainings"] = tree.pop("training")
        draft.note("group misspelt", "refused")
    text = json.dumps(tree, indent=1).replace("NaN", ".nan").replace("Infinity", ".inf")
    if kind == "twice":
        text = text.replace('"training": {', f'"training": {{"{key}": 1, ', 1)
        draft.note("a key twice", "refused")
    elif kind == "root":
        text = draft.pick(
            ["- a\n- b\n", "3", "", "name: [unclosed", "a: b: c", "%YAML 9\n---\n", "name: !!python/object:os.system x"]
        )
        draft.note("no experiment", "refused")
    elif kind == "deep":
        text = draft.pick(["[" * 5000, "extends: experiment.yaml\nname: a\n", "extends: 3\nname: a\n", "name: \x01\n"])
        draft.note("no experiment", "refused")
    stored(draft, folder / "experiment.yaml", text)
    return case(draft, lambda: _training(folder / "experiment.yaml", list(expected)), expected)


def _training(path: Path, keys: list[str]) -> Mapping[str, Any]:
    training = load_experiment(path).training
    return {key: getattr(training, key) for key in keys}


def schemas(random: np.random.Generator, folder: Path) -> Case:
    """The schema of annotations."""
    draft = Draft(random, [])
    tree: dict[str, Any] = {
        "extent": "full",
        "classes": {"vehicle": {"size_m": [4.5, 1.9, 1.6], "fastest_m_s": 40.0}, "Cone": {"size_m": [0.4, 0.4, 0.7]}},
        "attributes": {"parked": {"values": ["yes", "no"]}},
    }
    expected = {"vehicle": (4.5, 1.9, 1.6), "Cone": (0.4, 0.4, 0.7)}
    kind = draft.pick(["none", "size", "size", "size", "key", "extent", "root", "twice"])
    name = draft.pick(list(expected))
    entry = tree["classes"][name]
    if kind == "size":
        entry["size_m"] = draft.pick(
            [None, [1, 2], [1, 2, 3, 4], "big", [0, 1, 1], [-1, 1, 1], [1, 1, float("nan")], [True, 1, 1]]
        )
        draft.note(f"{entry['size_m']} as size_m", "refused")
    elif kind == "key":
        entry[draft.pick(["size", "SIZE_M", "speed"])] = entry.pop("size_m") if draft.random.random() < 0.5 else 3
        draft.note("key misspelt", "refused")
    elif kind == "extent":
        tree["extent"] = draft.pick(["Full", "whole", 3, True, ["full"]])
        draft.note(f"{tree['extent']!r} as extent", "refused")
    text = json.dumps(tree, indent=1).replace("NaN", ".nan")
    if kind == "root":
        text = draft.pick(["- a\n", "3", "", "classes: [unclosed", "[" * 3000])
        draft.note("another root", "refused")
    elif kind == "twice":
        text = text.replace('"size_m"', '"size_m": [1, 1, 1], "size_m"', 1)
        draft.note("a key twice", "refused")
    stored(draft, folder / SCHEMA, text)
    return case(draft, lambda: _sizes(folder), expected)


def _sizes(folder: Path) -> Mapping[str, Any]:
    schema = load_schema(folder, Schema(classes={}))
    return {name: settings.size_m for name, settings in schema.classes.items()}


_PARTS: dict[str, Callable[[np.random.Generator, Path], Case]] = {
    "class mapping": class_mapping,
    "cirrus mapping": cirrus_mapping,
    "splits": splits,
    "kradar conditions": conditions,
    "kradar description": descriptions,
    "experiments": experiments,
    "annotation schema": schemas,
}
FAMILIES = tuple(Family(name, make, share=0.3 if name == "experiments" else 1.5) for name, make in _PARTS.items())
