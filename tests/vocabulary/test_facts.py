"""Facts that several rooms need stand once, in the vocabulary or below those who use them: read from the source."""

import ast
from collections.abc import Callable, Iterator, Mapping
from functools import cache

import pytest
from sources import trees

from farfield.vocabulary.classes import CIRRUS_FROM_ANY_KRADAR, CIRRUS_FROM_KRADAR
from farfield.vocabulary.conditions import CONDITIONS, UNKNOWN, WEATHER_COLOURS, WEATHERS
from farfield.vocabulary.kradar import REGIONS_M
from farfield.vocabulary.patterns import PATTERNS
from farfield.vocabulary.published_tables import RADAR_LEVELS, ROW_QUANTILES_DB, SHARES_NEAR_HORIZON


def _words(node: ast.AST) -> list[object]:
    """What a list, tuple or set, a Literal, or the keys of a mapping spell out."""
    parts: list[ast.expr | None] = []
    if isinstance(node, ast.List | ast.Tuple | ast.Set):
        parts = list(node.elts)
    elif isinstance(node, ast.Dict):
        parts = list(node.keys)
    return [part.value for part in parts if isinstance(part, ast.Constant)]


def _values(node: ast.AST) -> list[object]:
    return [part.value for part in node.values if isinstance(part, ast.Constant)] if isinstance(node, ast.Dict) else []


@cache
def _literals() -> Mapping[str, list[ast.AST]]:
    """What each module spells out: its constants, lists, tuples, sets and mappings."""
    kinds = ast.Constant | ast.List | ast.Tuple | ast.Set | ast.Dict
    return {name: [node for node in ast.walk(tree) if isinstance(node, kinds)] for name, tree in trees().items()}


def _holding(test: Callable[[ast.AST], bool]) -> list[str]:
    return sorted(name for name, nodes in _literals().items() if any(test(node) for node in nodes))


def _spelling_out(*wanted: object) -> list[str]:
    return _holding(lambda node: set(wanted) <= {str(word) for word in _words(node)})


def _text_holding(text: str) -> list[str]:
    return _holding(lambda node: isinstance(node, ast.Constant) and isinstance(node.value, str) and text in node.value)


def _constants() -> Iterator[tuple[str, str, ast.expr]]:
    """Module-level names with what is assigned to them."""
    for name, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                yield from ((name, target.id, node.value) for target in targets if isinstance(target, ast.Name))


def test_weathers_roads_and_kinds_of_condition_stand_once() -> None:
    assert _spelling_out(*WEATHERS[1:]) == ["vocabulary/conditions.py"]
    builders = "simulation/world/roads/__init__.py"  # a mapping of each road to what builds it
    assert _spelling_out(*CONDITIONS["road"]) == [builders, "vocabulary/conditions.py"]
    kinds = {(name, tuple(_words(value))) for name, _, value in _constants() if set(_words(value)) == set(CONDITIONS)}
    assert kinds == {  # ours, and the order of the words in description.txt and in the kit's desc
        ("vocabulary/conditions.py", ("weather", "road", "time")),
        ("vocabulary/kradar.py", ("road", "time", "weather")),
        ("vocabulary/kradar.py", ("time", "road", "weather")),
    }


def test_each_weather_has_one_colour() -> None:
    assert set(WEATHER_COLOURS) == {*WEATHERS, UNKNOWN}
    for colour in ("#c2255c", "#7048e8", "#2b8a3e"):
        mapped = _holding(lambda node, colour=colour: colour in _values(node))
        assert mapped == ["vocabulary/conditions.py"], colour


def test_the_58_sequences_stand_once() -> None:
    assert _text_holding("46 598 heavy_snow highway night") == ["vocabulary/kradar.py"]
    rows = _holding(lambda node: _words(node) == [598, "highway", "heavy_snow", "night"])
    assert rows == []
    assert _holding(lambda node: _words(node)[:6] == [32, 30, 30, 41, 31, 34]) == ["vocabulary/kradar.py"]


def test_spellings_of_description_txt_stand_in_the_vocabulary_alone() -> None:
    for spelling in ("countryside", "parkinglots", "lightsnow", "heavysnow"):
        found = _holding(lambda node, word=spelling: isinstance(node, ast.Constant) and node.value == word)
        assert set(found) <= {"vocabulary/conditions.py", "vocabulary/kradar.py"}, spelling


def test_kradar_s_class_names_regions_and_ousters_stand_once() -> None:
    assert _holding(lambda node: isinstance(node, ast.Constant) and node.value == "Bicycle Group") == [
        "vocabulary/classes.py"
    ]
    assert list(CIRRUS_FROM_ANY_KRADAR)[::2] == list(CIRRUS_FROM_KRADAR)
    assert list(CIRRUS_FROM_ANY_KRADAR)[:4] == ["Sedan", "sed", "Bus or Truck", "bus"]
    bounds = {name for name, _, value in _constants() if list(REGIONS_M) == _words(value)[: len(REGIONS_M)]}
    assert bounds == {"vocabulary/kradar.py"}
    top = _holding(lambda node: isinstance(node, ast.Constant) and node.value == REGIONS_M["wide"][5])
    assert [name for name in top if not name.startswith("simulation/")] == ["vocabulary/kradar.py"]
    lines = _holding(lambda node: {"os1-128", "os2-64"} <= set(_words(node)) and 128 in _values(node))
    assert lines == ["vocabulary/kradar.py"]


def test_the_two_scan_patterns_are_named_once() -> None:
    named = [f"{name}:{target}" for name, target, value in _constants() if set(_words(value)) >= set(PATTERNS)]
    assert set(named) <= {  # the others map patterns, among more, to something of their own
        "vocabulary/patterns.py:PATTERNS",
        "datasets/cirrus/layout.py:KINDS",
        "datasets/cirrus/writer.py:_EXTRA_COLUMNS",
        "simulation/recording/frames.py:_BYTES_PER_SHOT",
        "simulation/recording/raw/clocks.py:KINDS",
    }


@pytest.mark.parametrize("figures", [SHARES_NEAR_HORIZON, RADAR_LEVELS, ROW_QUANTILES_DB])
def test_published_figures_stand_once(figures: dict[str, str]) -> None:
    assert _holding(lambda node: list(figures) == _words(node) and bool(_values(node))) == [
        "vocabulary/published_tables.py"
    ]
    numbers = [float(text) for text in figures.values() if text.replace(".", "").isdigit()]
    assert _holding(lambda node: len(numbers) > 2 and _values(node) == numbers) == []


def test_the_margin_round_boxes_stands_once() -> None:
    margins = [
        f"{name}:{target}"
        for name, target, value in _constants()
        if name != "simulation/labels.py"  # what simulated annotators leave: an input of its own
        and "MARGIN" in target
        and isinstance(value, ast.Constant)
        and value.value == 0.05
    ]
    assert margins == ["geometry/boxes.py:BOX_MARGIN_M"]


def test_whether_data_are_simulated_is_decided_in_one_place() -> None:
    named = _holding(lambda node: isinstance(node, ast.Constant) and node.value == "simulation.json")
    assert set(named) <= {"frame/provenance.py", "cli/simulate.py", "cli/train.py"}  # the latter write it and go on
