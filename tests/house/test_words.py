"""The words of the code: the field's, one name for one class, no word that says nothing. See docs/glossary.md."""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from sources import sources, trees

ROOT = Path(__file__).resolve().parents[2]

EMPTY_WORDS = {"found", "kept", "seen", "known", "told", "given", "each", "place", "wanted", "asked", "said"}
"""Participles and fillers that name no variable and no argument."""

MOST = {
    "studio": 1,  # a field of a message to the page
}
"""Bindings of such words that a room may still hold, until they are renamed: these numbers only fall."""

EMPTY_MODULES = {"settings", "work", "parts", "words", "common", "base", "contract", "helpers", "misc", "utils"}
"""Names of modules that say nothing, unless their folder explains them."""

EXPLAINED = {
    "adaptation/base.py": "what every method of adaptation inherits",
    "datasets/base.py": "the Dataset that every reader inherits",
    "metrics/centre/settings.py": "the options of the scores by distance of centres",
    "metrics/argoverse2/settings.py": "the options of Argoverse 2's metrics",
    "metrics/kradar/settings.py": "the options of K-Radar's average precision",
    "metrics/waymo/settings.py": "the options of Waymo's metrics",
}
"""Modules of such names that may stay, and what explains them."""

OLD_TEXTS = re.compile(r"[Nn]umbers a point|points without a place|answers for")
"""Phrases that were thrown out of docstrings, comments and messages."""


def _bound_words(tree: ast.Module) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in EMPTY_WORDS:
            yield node.lineno, node.id
        elif isinstance(node, ast.arg) and node.arg in EMPTY_WORDS:
            yield node.lineno, node.arg


def test_variables_are_called_what_they_are() -> None:
    bindings = defaultdict(list)
    for name, tree in trees().items():
        bindings[Path(name).parts[0]] += [f"{name}:{line} {word}" for line, word in _bound_words(tree)]
    over = {room: rows for room, rows in bindings.items() if len(rows) > MOST.get(room, 0)}
    assert not over, "\n".join(row for rows in over.values() for row in rows[:20])


def test_a_class_name_exists_once() -> None:
    places = defaultdict(list)
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{name}:{node.lineno}")
    twice = {name: files for name, files in places.items() if len(files) > 1}
    assert not twice


def test_modules_have_names_that_say_something() -> None:
    names = {name for name in sources() if Path(name).stem in EMPTY_MODULES}
    assert names == EXPLAINED.keys()


def test_texts_do_not_return_to_private_words() -> None:
    lines = [
        f"{name}:{number} {match.group()}"
        for name, text in sources().items()
        for number, line in enumerate(text.splitlines(), 1)
        if (match := OLD_TEXTS.search(line))
    ]
    assert not lines, "\n".join(lines)


def test_the_plan_on_the_wall_is_the_one_that_is_enforced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    plan = __import__("plan")
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert plan.with_plan(page) == page, "run: python tools/plan.py --write"
    sys.modules.pop("plan")


def test_each_term_of_the_glossary_stands_once() -> None:
    page = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    terms = re.findall(r"^\| ([^|]+?) \|", page, flags=re.MULTILINE)
    terms = [term for term in terms if term not in ("term", "---")]
    assert len(terms) > 50
    assert len(terms) == len(set(terms))
