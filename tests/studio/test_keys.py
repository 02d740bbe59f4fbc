"""The table of keys: one meaning a key, and the map in docs/studio.md made from it."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
KEYS = json.loads((ROOT / "web" / "src" / "keys.json").read_text())
MODIFIERS = ("ctrl", "shift", "alt")
KEPT_BY_THE_BROWSER = {"Ctrl+KeyW", "Ctrl+KeyT", "Ctrl+KeyN"}


def chords(key: dict) -> list[str]:
    """All combinations that a row of the table takes: a scaled one also with Shift, with Alt, and with both."""
    combinations = [(s, a) for s in (False, True) for a in (False, True)] if key.get("scaled") else None
    out = []
    for shift, alt in combinations or [(key.get("shift", False), key.get("alt", False))]:
        parts = [name for name, on in zip(("Ctrl", "Shift", "Alt"), (key.get("ctrl"), shift, alt), strict=True) if on]
        out.append("+".join([*parts, key["code"]]))
    return out


def test_no_key_has_two_meanings_in_a_mode():
    for mode in ("view", "annotate", "calibrate"):
        bound = [(chord, key["id"]) for key in KEYS if mode in key["modes"] for chord in chords(key)]
        assert len(dict(bound)) == len(bound), [pair for pair in bound if [c for c, _ in bound].count(pair[0]) > 1]


def test_no_key_is_one_that_the_browser_keeps():
    assert not {chord for key in KEYS for chord in chords(key)} & KEPT_BY_THE_BROWSER


def test_every_row_is_whole_and_every_action_is_there():
    source = "\n".join(path.read_text() for path in sorted((ROOT / "web" / "src").glob("*.ts")))
    assert all({"id", "code", "modes", "group", "title"} <= set(key) for key in KEYS)
    bound = set(re.findall(r'(?:bind|nudge|sizeKey)\("([a-z0-9.]+)"', source))
    made = {f"{name}.{way}" for name in ("length", "width", "height") for way in ("less", "more")}
    digits = {f"class.{digit}" for digit in range(1, 10)}
    assert {key["id"] for key in KEYS} == bound | made | digits


@pytest.mark.parametrize("table", ["key_map", "figures"])
def test_the_tables_in_the_documentation_are_those_that_are_made(monkeypatch, table: str):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import make_studio

    text = (ROOT / "docs" / "studio.md").read_text()
    assert getattr(make_studio, table)() in text, "run `python docs/make_studio.py`"
