"""JSON edited in place: what is not edited keeps its bytes."""

import json
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.errors import FileFormatError
from farfield.files.json_text import append, finite, parse_json, plain_json, read_json, remove, set_value, span

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats(-9, 9) | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=4),
    max_leaves=12,
)
TEXT = '{"a" : [1.50, 2e0,\n  {"b": "x,]"}],\n "c": {}}\n'


def ways(value: Any, before: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [before, *(way for name, child in inner for way in ways(child, (*before, name)))]


def at(value: Any, way: tuple[str | int, ...]) -> Any:
    for step in way:
        value = value[step]
    return value


@given(value=VALUES, indent=st.sampled_from([None, 0, 1, 3]), data=st.data())
def test_any_value_is_found_changed_removed_and_followed(value: Any, indent: int | None, data: st.DataObject) -> None:
    text = json.dumps(value, indent=indent)
    way = data.draw(st.sampled_from(ways(value)))
    found = span(text, way)
    assert found is not None
    assert json.loads(text[slice(*found)]) == at(value, way)
    assert set_value(text, way, at(value, way)) == text
    changed = json.loads(set_value(text, way, {"new": [1]}))
    assert at(changed, way) == {"new": [1]}
    if way:
        without = json.loads(text)
        del at(without, way[:-1])[way[-1]]
        assert json.loads(remove(text, way)) == without
    if isinstance(at(value, way), list):
        longer = json.loads(append(text, way, 7))
        assert at(longer, way) == [*at(value, way), 7]


def test_all_else_keeps_its_bytes() -> None:
    assert set_value(TEXT, ("a", 0), 1.25) == TEXT.replace("1.50", "1.25")
    assert set_value(TEXT, ("a", 2, "b"), "y") == TEXT.replace("x,]", "y")
    assert set_value(TEXT, ("a", 2, "new"), 3) == TEXT.replace('"x,]"', '"x,]", "new": 3')
    assert remove(TEXT, ("a", 1)) == TEXT.replace("2e0,\n  ", "")
    assert remove(TEXT, ("none",)) == TEXT
    assert append(TEXT, ("c",), 1, key="k") == TEXT.replace("{}", '{"k": 1}')
    indented = json.dumps([{"a": 1}, {"a": 2}], indent=1)
    assert append(indented, (), 5) == indented.replace("\n]", ",\n 5\n]")
    with pytest.raises(KeyError):
        append(TEXT, ("none",), 1)


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"{", "line 1"),
        (b"", "an empty file"),
        (b"\xff", "no UTF-8"),
        (b"[NaN]", "NaN"),
        (b"[-Infinity]", "Infinity"),
        (b"[1e999]", "1e999, which is not finite"),
        (b"[-1E+400]", "not finite"),
        (b"1" * 400 + b".0", "not finite"),
        (b"1" * 5000, "beyond 64 bits"),
        (b"[18446744073709551616]", "beyond 64 bits"),
        (b"[-9223372036854775809]", "beyond 64 bits"),
        (b'{"a": 1, "a": 2}', "'a' twice in one object"),
        (b"[" * 100_000, "deeper than 64"),
        (b'{"a":' * 100_000, "deeper than 64"),
        (b'["]]]]]]]]]]]",' * 70 + b"1" + b"]" * 70, "deeper than 64"),
        (b'["\\"]]]]]]]]",' * 70 + b"1" + b"]" * 70, "deeper than 64"),
        (b'["\\ud800"]', "surrogates not allowed"),
        (b'{"\\uDFFF": 1}', "surrogates not allowed"),
        (b"[" + b"{}," * 6_500_000 + b"1]", r"values that take 1\."),
        (b"[" + b'"",' * 13_500_000 + b"1]", r"values that take 1\."),
    ],
)
def test_what_is_not_json_is_refused(data: bytes, fault: str) -> None:
    began = time.process_time()
    with pytest.raises(FileFormatError, match=f"expected JSON, found .*{fault}"):
        parse_json(data, "labels.json")
    with pytest.raises(ValueError, match=r"."):
        plain_json(data)
    assert time.process_time() - began < 10


def test_bounds(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="at most 3 bytes"):
        parse_json(b"[1, 2]", "labels.json", max_bytes=3)
    assert parse_json(b'\xef\xbb\xbf["[[["]', "labels.json") == ["[[["]
    assert plain_json("[" * 64 + "]" * 64) == plain_json(b"[" * 64 + b"]" * 64)
    whole = [18446744073709551615, -9223372036854775808, 1e300, 1.5e-400, "1e999", "\U0001f600"]
    assert plain_json(json.dumps(whole)) == whole
    (tmp_path / "a.json").write_bytes(b"[1]")
    assert read_json(tmp_path / "a.json") == [1]
    with pytest.raises(FileFormatError, match="at most 2 bytes"):
        read_json(tmp_path / "a.json", max_bytes=2)
    assert finite(10**400) is None
    assert finite(-3) == -3.0
